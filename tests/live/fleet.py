"""A whole simulated fleet as a user starts it: `tutti up --sim` in a process of its own, and the true motions."""

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Coroutine, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from children import LIMIT_S, wait_until
from forks import run_forked

from orchestrator.bus.keys import STANDBY
from orchestrator.client import Tutti
from orchestrator.clock.live import raw_ns
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport
from orchestrator.model.state import ControllerState

LOOK_S = 0.5
T = TypeVar("T")
Entry = dict[str, Any]
Steps = list[dict[str, Any]]

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
COMMAND = [sys.executable, "-c", "from orchestrator.cli.main import main; main(prog_name='tutti')"]

READY: Steps = [
    {"do": "enable", "axes": ["gantry", "stage"]},
    {"do": "home"},
    {"do": "move", "to": {"gantry.x": 1, "gantry.y": 1, "stage.u": 1, "stage.v": 1}},
]
BACK: dict[str, Any] = {"do": "move", "to": {"gantry.x": 1, "stage.u": 1}}
# Takes 40 s: an axis that is at rest before was stopped.
SLOW: Steps = [{"do": "move", "to": {"gantry.x": 201, "stage.u": 21}, "speed": 0.05}]
SLOW_AXES = {"gantry": "X", "stage": "1"}


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


class ReachedFleet:
    """The demo fleet, or one of that name, at the router `endpoint`. folder: of what is written for it; state: of the
    truth of its simulators, and of logs."""

    def __init__(self, folder: Path, endpoint: str, state: Path) -> None:
        self.folder = folder
        self.endpoint = endpoint
        self.state = state

    def works(self) -> None:
        """Wait until there is a leader that every adapter has adopted."""

        states: dict[str, ControllerState] = {}

        def adopted() -> bool:
            states.clear()
            states.update(self.status())
            return len(states) == 2 and all(s.mode == "idle" and s.epoch == self.epoch() for s in states.values())

        try:
            wait_until(adopted, "adopted and idle")
        except AssertionError as error:
            shown = {name: (s.mode, s.epoch, s.job, [each.text for each in s.faults]) for name, s in states.items()}
            raise AssertionError(f"{error}; epoch {self.epoch()}, {shown}") from None

    def epoch(self) -> int:
        """The newest epoch in the log of this fleet's own coordinator."""
        return max((entry.get("epoch") or 0 for entry in self.log("coordinator")), default=0)

    def log(self, name: str) -> list[Entry]:
        path = self.state / "log" / f"{name}.jsonl"
        whole = path.read_text().rpartition("\n")[0] if path.exists() else ""
        return [json.loads(line) for line in whole.splitlines()]

    def has_standby(self) -> bool:
        """Whether a coordinator stands by."""

        async def look(tutti: Tutti) -> bool:
            present = asyncio.Event()
            expression = tutti.keys.live("coordinator", None, STANDBY)
            watching = await tutti.bus.watch(expression, lambda _, is_there: present.set() if is_there else None)
            with suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S):
                    await present.wait()
            await watching.undeclare()
            return present.is_set()

        return self.ask(look)

    # What users do

    def tutti(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """The command line, connected to this fleet."""
        return run_tutti(*arguments, "--connect", self.endpoint)

    def file(self, steps: Steps, name: str = "test") -> Path:
        path = self.folder / f"{name}.job.json"
        path.write_text(json.dumps({"schema": "tutti.job/1", "name": name, "max_start_skew": "50 ms", "steps": steps}))
        return path

    def ask(self, act: Callable[[Tutti], Coroutine[Any, Any, T]], limit_s: float = LIMIT_S) -> T:
        async def main() -> T:
            async with asyncio.timeout(limit_s), Tutti(self.endpoint, "demo", "test") as tutti:
                return await act(tutti)

        return asyncio.run(main())

    def status(self) -> dict[str, ControllerState]:
        return self.ask(lambda tutti: tutti.status(0.5))

    def submit(self, steps: Steps) -> str:
        job = Job.model_validate_json(self.file(steps).read_text())
        return self.ask(lambda tutti: tutti.submit(job))

    def wait(self, job_id: str) -> JobReport:
        return self.ask(lambda tutti: tutti.wait_for_job(job_id, poll_s=0.1))

    def run(self, steps: Steps) -> JobReport:
        return self.wait(self.submit(steps))

    def ready(self) -> None:
        """Bring all axes to the beginning from any position: the fleet works, and its queue is started."""
        self.ask(lambda tutti: tutti.reset())  # the test before may have left an emergency stop in a controller
        self.works()
        self.ask(lambda tutti: tutti.start_queue())
        report = self.run(READY)
        assert report.state == "done", report.reason

    def bring_back(self) -> None:
        """As `ready`, for the axes of a slow move, of which only those are homed that have lost their reference: all
        axes take 4 s."""
        self.ask(lambda tutti: tutti.reset())
        self.works()
        self.ask(lambda tutti: tutti.start_queue())
        states = self.status()
        axes = {f"{name}.{axis}": states[name].axes[axis] for name, axis in (("gantry", "x"), ("stage", "u"))}
        lost = [name for name, axis in axes.items() if not axis.referenced]
        steps: Steps = READY[:1] if not all(axis.enabled for axis in axes.values()) else []
        steps = [*steps, *([{"do": "home", "axes": lost}] if lost else []), BACK]
        report = self.run(steps)
        assert report.state == "done", report.reason

    # What really moved

    def truth(self, controller: str) -> list[Entry]:
        """The record of the simulator, in order."""
        path = self.state / "truth" / f"{controller}.jsonl"
        whole = path.read_text().rpartition("\n")[0] if path.exists() else ""
        return [json.loads(line) for line in whole.splitlines()]

    def starts(self, controller: str) -> int:
        """How often an axis of the controller has started to move."""
        return sum(entry["event"] == "start" for entry in self.truth(controller))

    def slow_move(self, steps: Steps = SLOW) -> str:
        """Start a slow move; return its job when both controllers really move."""
        before = {name: self.starts(name) for name in SLOW_AXES}
        job_id = self.submit(steps)

        def both_move() -> bool:
            said = [entry["text"] for entry in self.log("coordinator") if entry.get("job") == job_id]
            assert not any(text.startswith(("job is failed", "job is aborted")) for text in said), said
            return all(self.starts(name) > count for name, count in before.items())

        wait_until(both_move, "both move")
        return job_id

    def at_rest(self, controller: str) -> Entry:
        """How its last motion ended; also waited for at rest: the simulator records it a little later."""
        wait_until(lambda: self.truth(controller)[-1]["event"] == "end", f"{controller} comes to rest")
        return self.truth(controller)[-1]

    def rest_ns(self, controller: str) -> int:
        """When the slow axis of the controller came to rest, host time; waited for."""

        def last() -> Entry:
            return [entry for entry in self.truth(controller) if entry["axis"] == SLOW_AXES[controller]][-1]

        wait_until(lambda: last()["event"] == "end", f"{controller} comes to rest")
        return last()["end_ns"]


class RunningFleet(ReachedFleet):
    """The demo fleet, or one of that name, under `tutti up --sim`, with everything it writes in `folder`. recorded, web:
    with a recorder, a gateway, which take a process more each."""

    def __init__(
        self,
        folder: Path,
        fleet: Path = EXAMPLES / "demo.fleet.yaml",
        *options: str,
        recorded: bool = False,
        web: bool = False,
    ) -> None:
        self.port = free_port()
        super().__init__(folder, f"tcp/127.0.0.1:{self.port}", folder / "state")
        self.said = folder / "up.out"
        command = [*COMMAND, "up", str(fleet), "--sim", "--truth"]
        command += ["--state", str(self.state), "--port", str(self.port), *options]
        command += [] if recorded else ["--no-record"]
        command += [] if web else ["--no-web"]
        with self.said.open("w") as out:
            self.up = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
        self._known: set[int] = set()

    # Life

    def started(self) -> "RunningFleet":
        """Wait until it is up and every controller is adopted."""
        wait_until(lambda: "is up" in self.output() or self.up.poll() is not None, "the fleet is up")
        assert self.up.poll() is None, self.output()
        self.works()
        return self

    def output(self) -> str:
        return self.said.read_text()

    def family(self) -> dict[int, str]:
        """Command lines of all living descendants of `tutti up`, and of those that were seen before."""
        living = list_processes()
        grown = find_descendants({self.up.pid, *(self._known & living.keys())}, living)
        self._known |= grown - {self.up.pid}
        return {pid: living[pid][1] for pid in self._known if pid in living}

    def pid(self, words: str) -> int:
        """The process id of the descendant whose command line contains `words`."""
        found = [pid for pid, command in self.family().items() if words in command]
        assert len(found) == 1, f"{words}: {found}"
        return found[0]

    def kill(self, words: str) -> int:
        """`kill -9`; the host time of it, and it is dead."""
        pid = self.pid(words)
        at_ns = raw_ns()
        os.kill(pid, signal.SIGKILL)
        wait_until(lambda: pid not in list_processes(), f"{words} is dead")
        return at_ns

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        """End `tutti up` by a signal: its exit code. Nothing of it lives on."""
        self.family()
        self.up.send_signal(number)
        code = self.up.wait(LIMIT_S)
        wait_until(lambda: not self.family(), f"orphans end: {self.family()}")
        return code

    def close(self) -> None:
        """Clean up after a test."""
        self.family()
        if self.up.poll() is None:
            self.up.terminate()
            try:
                self.up.wait(LIMIT_S)
            except subprocess.TimeoutExpired:
                self.up.kill()
                self.up.wait()
        for pid in self.family():
            os.kill(pid, signal.SIGKILL)
        # Shown with a failed test only.
        for said in (self.said, *sorted((self.state / "log").glob("*.err"))):
            sys.stdout.write(f"--- {said.name}\n{said.read_text()[-4000:]}\n")


def run_tutti(*arguments: str, **variables: str) -> "subprocess.CompletedProcess[str]":
    """The `tutti` command to its end, with additional variables of the environment."""
    environment = {**os.environ, "COLUMNS": "200", **variables}
    return run_forked([*COMMAND[1:], *arguments], environment, 2 * LIMIT_S)


def run_example(name: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    """A program of `deploy/examples` to its end."""
    return run_forked([str(EXAMPLES / name), *arguments], os.environ, LIMIT_S)


def list_processes() -> dict[int, tuple[int, str]]:
    """Parent and command line of every process that has not ended."""
    found: dict[int, tuple[int, str]] = {}
    for path in Path("/proc").iterdir():
        if not path.name.isdecimal():
            continue
        try:
            state, parent = (path / "stat").read_text().rpartition(")")[2].split()[:2]
            if state != "Z":
                found[int(path.name)] = int(parent), (path / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except (OSError, ValueError):
            continue
    return found


def find_descendants(processes: set[int], living: Mapping[int, tuple[int, str]]) -> set[int]:
    """These processes with all their descendants. living: as of `list_processes`."""
    grown = set(processes)
    while more := {pid for pid, (parent, _) in living.items() if parent in grown} - grown:
        grown |= more
    return grown


def margin_s(at_ns: int, rest_ns: int) -> float:
    """How long after `at_ns` something came to rest, in seconds."""
    return (rest_ns - at_ns) / 1e9


def wait_a_moment(until: Callable[[], bool], duration_s: float) -> bool:
    """Watch for an event that must not occur, for as long as it would take; return whether it occurred."""
    end_s = time.monotonic() + duration_s
    while time.monotonic() < end_s:
        if until():
            return True
        time.sleep(0.02)
    return False
