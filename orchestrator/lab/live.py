"""A fleet live on this machine: router, simulators, adapter hosts under guardians, coordinator, as child processes.

A child that dies is started again with growing pauses. Children have sessions of their own, so that Ctrl-C reaches
only this process, which ends them in order: the coordinator first, because it stops what moves.
"""

import asyncio
import json
import os
import signal
import socket
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from orchestrator.model.fleet import Controller, Fleet, SerialLink, TcpLink

READY_S = 30.0  # on a busy machine the interpreter alone takes seconds to start
END_S = 8.0
RESTART_S = (0.2, 0.5, 1.0, 2.0, 5.0)
# These ends are final: starting again would give the same (bad input, port or reign taken, deposed).
FINAL = frozenset({2, 4, 5, 6})

Say = Callable[[str], None]


class UpFailed(Exception):
    """The fleet can not be brought up. Says which part, why, and what to do."""


@dataclass(slots=True)
class Child:
    """One process of the fleet."""

    name: str
    command: Sequence[str]
    log: Path
    process: asyncio.subprocess.Process | None = None
    starts: int = 0
    ready: str = ""
    ended: bool = False
    keeper: "asyncio.Task[None] | None" = None

    @property
    def pid(self) -> int:
        """Process id of the present start."""
        return self.process.pid if self.process else 0


@dataclass(slots=True)
class LiveFleet:
    """Everything that `tutti up` runs. `say` gets lines for people.

    connect: a router that is there; without it one is started on `port`. simulated: every link is replaced by that of
    a simulated controller. truth: simulators write what they really did to `state`/truth.
    """

    fleet: Fleet
    state: Path
    say: Say
    connect: str = ""
    port: int = 7447
    simulated: bool = False
    take_over: bool = False
    truth: bool = False
    children: dict[str, Child] = field(default_factory=dict[str, Child])
    failed: "asyncio.Future[str] | None" = None

    async def start(self) -> None:
        """Bring everything up, in order. Raises `UpFailed`; then nothing is left running."""
        self.failed = asyncio.get_running_loop().create_future()
        self.state.mkdir(parents=True, exist_ok=True)
        try:
            if self.simulated:
                await self._simulate()
            await self._route()
            file = self.state / "fleet.json"
            file.write_text(self.fleet.model_dump_json(), encoding="utf-8")
            for host in dict.fromkeys(config.host for config in self.fleet.controllers.values()):
                await self._start_child(f"host/{host}", self._host_command(host, file))
            await self._start_child("coordinator", self._coordinator_command(file))
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """End all children, the coordinator first and the router last."""
        order = ["coordinator", "host", "sim", "router"]
        for child in sorted(self.children.values(), key=lambda each: order.index(each.name.partition("/")[0])):
            await self._end(child)

    # Parts

    async def _simulate(self) -> None:
        """Replace every link by that of a simulated controller."""
        controllers: dict[str, Controller] = {}
        for name, config in self.fleet.controllers.items():
            child = await self._start_child(f"sim/{name}", self._simulator_command(name, config))
            place = json.loads(child.ready)
            link = (
                TcpLink(host=place["host"], port=place["port"])
                if place["kind"] == "tcp"
                else config.link.model_copy(update={"device": place["device"]})
            )
            controllers[name] = config.model_copy(update={"link": link})
            self.say(f"{name}: simulated {config.adapter} on {link.place} (instead of {config.link.place})")
        self.fleet = self.fleet.model_copy(update={"controllers": controllers})

    async def _route(self) -> None:
        if self.connect:
            return
        endpoint = f"tcp/127.0.0.1:{self.port}"
        module = "orchestrator.bus.router_process"
        await self._start_child("router", [sys.executable, "-m", module, endpoint, str(os.getpid())])
        self.connect = endpoint
        self.say(f"router on {endpoint}")

    def _simulator_command(self, name: str, config: Controller) -> list[str]:
        simulate = config.simulate
        if isinstance(config.link, SerialLink):
            # What was listened on before is listened on again after a restart: the symlink is stable.
            listen = ["--listen", f"pty:{self.state / 'ports' / name}", "--baud", str(config.link.baud)]
        else:
            listen = ["--listen", f"tcp:127.0.0.1:{free_port()}"]
        timing = {"decode_ns": simulate.decode_us * 1000, "spread_ns": simulate.spread_us * 1000}
        oscillator = {
            "offset_ns": round(simulate.offset_s * 1e9),
            "drift_ppm": simulate.drift_ppm,
            "wander_ppm": simulate.wander_ppm,
        }
        command = [sys.executable, "-m", "sim.link.process", "--model", config.adapter, "--name", name, *listen]
        command += ["--options", json.dumps(simulate.options), "--timing", json.dumps(timing)]
        command += ["--oscillator", json.dumps(oscillator)]
        if self.truth:
            command += ["--truth", str(self.state / "truth" / f"{name}.jsonl")]
        return command

    def _host_command(self, host: str, file: Path) -> list[str]:
        command = [sys.executable, "-m", "adapters.guardian", "--fleet", str(file), "--host", host]
        command += ["--connect", self.connect, "--state", str(self.state / "adapters")]
        return [*command, "--log", str(self.state / "log" / f"host-{host}.jsonl")]

    def _coordinator_command(self, file: Path) -> list[str]:
        command = [sys.executable, "-m", "orchestrator.coordinator.process", "--fleet", str(file)]
        command += ["--connect", self.connect, "--journal", str(self.state / "journal.sqlite3")]
        command += ["--log", str(self.state / "log" / "coordinator.jsonl"), "--parent", str(os.getpid())]
        return [*command, "--take-over"] if self.take_over else command

    # Children

    async def _start_child(self, name: str, command: Sequence[str]) -> Child:
        log = self.state / "log" / f"{name.replace('/', '-')}.err"
        child = self.children[name] = Child(name, command, log)
        await self._spawn(child)
        child.keeper = asyncio.get_running_loop().create_task(self._keep(child))
        return child

    async def _spawn(self, child: Child) -> None:
        """Start the process and wait for its first line. Raises `UpFailed` with what it said."""
        child.log.parent.mkdir(parents=True, exist_ok=True)
        with child.log.open("ab") as errors:
            child.process = await asyncio.create_subprocess_exec(
                *child.command,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=errors,
                start_new_session=True,
            )
        child.starts += 1
        assert child.process.stdout is not None
        try:
            async with asyncio.timeout(READY_S):
                line = await child.process.stdout.readline()
        except TimeoutError:
            raise UpFailed(f"{child.name} is not ready after {READY_S:g} s; see {child.log}") from None
        if not line:
            code = await child.process.wait()
            said = child.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            raise UpFailed(f"{child.name} ended with exit code {code}: {said[-1] if said else f'see {child.log}'}")
        child.ready = line.decode().strip()

    async def _keep(self, child: Child) -> None:
        """Start a dead child again, unless it ended for good."""
        while True:
            assert child.process is not None
            code = await child.process.wait()
            if child.ended:
                return
            if code in FINAL:
                said = child.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
                self._fail(f"{child.name} ended: {said[-1] if said else f'exit code {code}'}")
                return
            pause_s = RESTART_S[min(child.starts, len(RESTART_S)) - 1]
            self.say(f"{child.name} ended ({_how(code)}); starting it again in {pause_s:g} s")
            await asyncio.sleep(pause_s)
            if child.ended:
                return
            try:
                await self._spawn(child)
            except UpFailed as error:
                self.say(str(error))
                if child.process.returncode is None:
                    child.process.kill()

    def _fail(self, text: str) -> None:
        self.say(text)
        if self.failed is not None and not self.failed.done():
            self.failed.set_result(text)

    async def _end(self, child: Child) -> None:
        child.ended = True
        process = child.process
        if process is not None and process.returncode is None:
            process.send_signal(signal.SIGTERM)
            process.send_signal(signal.SIGCONT)
            try:
                async with asyncio.timeout(END_S):
                    await process.wait()
            except TimeoutError:
                self.say(f"{child.name} did not end within {END_S:g} s and is killed")
                process.kill()
                await process.wait()
        if child.keeper is not None:
            child.keeper.cancel()


def free_port() -> int:
    """A TCP port that nobody listens on."""
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _how(code: int) -> str:
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
