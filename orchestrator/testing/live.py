"""A fleet of processes on this computer for tests and scripts, as `tutti up --sim` starts it.

with live_fleet("lab.fleet.yaml") as fleet:
    fleet.tutti.home()
"""

import asyncio
import json
import sys
import tempfile
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, TypeVar

from orchestrator.campaign.faults import POWER_CYCLE_NS
from orchestrator.client.api import Tutti
from orchestrator.client.blocking import BlockingTutti
from orchestrator.client.worker import LoopThread
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.live import raw_ns
from orchestrator.model.fleet import Fleet
from orchestrator.model.report import FINISHED_STATES
from orchestrator.runtime.checked import check_fleet, load_checked_fleet
from orchestrator.runtime.live.fleet import LiveFleet, find_free_port
from orchestrator.runtime.live.run import FleetRun
from orchestrator.runtime.readiness import find_origin_host_ns, wait_until_adopted
from orchestrator.testing.errors import (
    BadTest,
    CallbackFailed,
    FleetViolation,
    find_axis,
    find_choice,
    find_controller,
    parse_delay_ns,
)
from orchestrator.testing.testbed import FleetTestbed, call_scheduled
from orchestrator.testing.truth import AxisTruth
from sim.core.controller import CommandedMotion

T = TypeVar("T")

TRUTH_DELAY_NS = 500 * NS_PER_MS  # until a simulator has written what has happened
_NOT_RUNNING = "the fleet does not run; use it as `with live_fleet(…) as fleet:`"
LIVE_FAULTS = ("limit", "power-cycle", "power-off", "stall")


class _LiveTruth(AxisTruth):
    """The truth by the file that the simulator writes."""

    def __init__(self, name: str, testbed: "LiveTestbed") -> None:
        controller, axis = find_axis(testbed.fleet, name)
        super().__init__(name, axis, testbed.origin_ns)
        self._motor = axis.motors[0]
        self._file = testbed.state / "truth" / f"{controller}.jsonl"

    def _find_motions(self) -> list[CommandedMotion]:
        motions: dict[int, CommandedMotion] = {}
        text = self._file.read_text(encoding="utf-8") if self._file.exists() else ""
        for line in text.rpartition("\n")[0].splitlines():
            entry = json.loads(line)
            if entry["axis"] == self._motor:
                motion = CommandedMotion(self._motor, entry["start_ns"], entry["start_counts"])
                known_motion = motions.setdefault(entry["start_ns"], motion)
                known_motion.end_ns, known_motion.end_counts = entry.get("end_ns"), entry.get("end_counts")
        return list(motions.values())

    def _find_counts(self, at_ns: int) -> float:
        self._require_past(at_ns, raw_ns() - TRUTH_DELAY_NS)
        motions = self._find_motions()
        begun_motions = [motion for motion in motions if motion.start_ns <= at_ns]
        if not begun_motions:
            return motions[0].start_counts if motions else 0.0
        last = begun_motions[-1]
        if last.end_ns is None or last.end_counts is None or last.end_ns > at_ns:
            raise BadTest(f"{self._name} moves at that time; in a live fleet its position is known at rest only")
        return last.end_counts


class LiveFault:
    """One fault of a live fleet."""

    def __init__(self, repair: Callable[[], None]) -> None:
        self._repair: Callable[[], None] | None = repair

    def repair(self) -> None:
        """Repair it now. May be called twice."""
        repair, self._repair = self._repair, None
        if repair is not None:
            repair()


class LiveTestbed(FleetTestbed):
    """A simulated fleet of processes. Made by `live_fleet`; use it as a context.

    fleet: its fleet file. state: its folder. tutti: a client.
    """

    def __init__(self, fleet: Fleet, *, check: bool) -> None:
        super().__init__(fleet, check=check)
        self._folder = tempfile.TemporaryDirectory(prefix="tutti-test-", ignore_cleanup_errors=True)
        self.state = Path(self._folder.name)
        self._messages: list[str] = []
        self._failures: list[CallbackFailed] = []
        self._worker: LoopThread | None = None
        self._live: LiveFleet | None = None
        self._tutti: BlockingTutti | None = None

    def __repr__(self) -> str:
        return f"<live fleet {self.fleet.fleet} in {self.state}>"

    # Begin and end

    def _start(self) -> None:
        self._worker = LoopThread()
        self._worker.run_coroutine(self._start_processes())
        self._tutti = self.connect("test")

    async def _start_processes(self) -> None:
        live = LiveFleet(self.fleet, self.state, self._messages.append, FleetRun.make_simulated(find_free_port()))
        await live.start()
        self._live = live
        async with Tutti(live.connect, self.fleet.fleet, "test") as tutti:
            await wait_until_adopted(tutti, len(self.fleet.controllers))
            self.origin_ns = await find_origin_host_ns(tutti)

    def check(self) -> None:
        """Check that all parts run, no job runs, and all axes are at rest. Raises `FleetViolation`."""
        if self._failures:
            raise self._failures[0]
        live = self._require_live()
        running_jobs = [job for job in self.tutti.list_jobs() if job.state not in (*FINISHED_STATES, "queued")]
        texts = [f"job {entry.name} is still {entry.state}; wait for it, or stop it" for entry in running_jobs]
        texts += [f"{name} moves" for name, axis in self.tutti.axes().items() if axis.moving or axis.homing]
        if live.failed is not None and live.failed.done():
            texts.append(live.failed.result())
        if texts:
            raise FleetViolation("\n  ".join([f"fleet {self.fleet.fleet} at the end of the test:", *texts]))

    def _end(self) -> None:
        tutti, self._tutti = self._tutti, None
        live, self._live = self._live, None
        worker, self._worker = self._worker, None
        try:
            if tutti is not None:
                tutti.close()
        finally:
            if worker is not None:
                if live is not None:
                    self._messages += self._read_log()
                    worker.run_coroutine(live.close())
                worker.close()
            self._folder.cleanup()

    # Requests

    @property
    def tutti(self) -> BlockingTutti:
        """The client of the test. Raises `BadTest` before the start."""
        if self._tutti is None:
            raise BadTest(_NOT_RUNNING)
        return self._tutti

    @property
    def endpoint(self) -> str:
        """The router, for other programs: `tcp/127.0.0.1:PORT`."""
        return self._require_live().connect

    def connect(self, actor: str) -> BlockingTutti:
        """Another client, with the name that its requests have; close it, or use it as a context."""
        return BlockingTutti(self.endpoint, self.fleet.fleet, actor).__enter__()

    def run(self, main: Callable[[Tutti], Coroutine[Any, Any, T]]) -> T:
        """Run the asynchronous `main(tutti)` to its end, and return its result."""

        async def run_connected() -> T:
            async with Tutti(self.endpoint, self.fleet.fleet, "test") as tutti:
                return await main(tutti)

        return self._require_worker().run_coroutine(run_connected())

    def _require_live(self) -> LiveFleet:
        if self._live is None:
            raise BadTest(_NOT_RUNNING)
        return self._live

    def _require_worker(self) -> LoopThread:
        if self._worker is None:
            raise BadTest(_NOT_RUNNING)
        return self._worker

    # Time

    @property
    def now_s(self) -> float:
        """The present instant in fleet time, s, as in reports."""
        return (raw_ns() - self.origin_ns) / NS_PER_S

    def advance(self, duration: str | float) -> None:
        """Wait. Raises `BadTest`."""
        time.sleep((parse_delay_ns("advance", duration) or 0) / NS_PER_S)

    def _call_at(self, function: Callable[[], object], at_ns: int | None) -> None:
        if at_ns is None:
            function()
            return

        due_ns = raw_ns() - self.origin_ns + at_ns

        def call_function() -> None:
            try:
                call_scheduled(function, due_ns)
            except CallbackFailed as failure:
                self._failures.append(failure)

        async def start_timer() -> None:
            asyncio.get_running_loop().call_later(at_ns / NS_PER_S, call_function)

        self._require_worker().run_coroutine(start_timer())

    # The physical environment

    def fail(
        self, controller: str, fault: str, *, at: str | float | None = None, until: str | float | None = None
    ) -> LiveFault:
        """Inject a fault by its name, now or at a time from now: limit, power-cycle, power-off, stall.

        Raises `UnknownName`; the other faults of the campaign need a virtual fleet.
        """
        config = find_controller(self.fleet, controller)
        find_choice("fault of a live fleet", fault, LIVE_FAULTS)
        motor = next(iter(config.axes.values())).motors[0]
        changes: dict[str, tuple[dict[str, object], dict[str, object]]] = {
            "power-off": ({"power": False}, {"power": True}),
            "power-cycle": ({"power": False}, {"power": True}),
            "limit": ({"limit": [motor, "both"]}, {"limit": [motor, "none"]}),
            "stall": ({"stall": [motor, True]}, {"stall": [motor, False]}),
        }
        begin, end = changes[fault]
        at_ns, until_ns = parse_delay_ns("at", at), parse_delay_ns("until", until)
        if fault == "power-cycle":
            until_ns = (at_ns or 0) + POWER_CYCLE_NS
        self._call_at(lambda: self._change_now(controller, begin), at_ns)
        entry = LiveFault(lambda: self._change_now(controller, end))
        if until_ns is not None:
            self._call_at(entry.repair, until_ns)
        return entry

    def _change_now(self, controller: str, change: dict[str, object]) -> None:
        self._require_live().change_simulation(controller, **change)

    # What has happened

    def truth(self, axis: str) -> AxisTruth:
        """The true motion of `controller.axis`, half a second late. Raises `UnknownName`."""
        return _LiveTruth(axis, self)

    @property
    def log(self) -> list[str]:
        """What the processes have written so far: JSON lines of coordinator and adapter hosts, in order of time."""
        return self._messages + (self._read_log() if self._live is not None else [])

    def _read_log(self) -> list[str]:
        files = sorted((self.state / "log").glob("*.jsonl"))
        lines = [line for file in files for line in file.read_text(encoding="utf-8").splitlines()]
        return sorted(lines)


def live_fleet(fleet: Path | str | Fleet, *, check: bool = True) -> LiveTestbed:
    """A simulated fleet of processes on free ports of this computer, from a fleet file or a `Fleet`; use it as a
    context.

    check: check at the end that no job runs and nothing moves. Raises `FileError` with every mistake of the file, and
    `BadTest` on another system than Linux.
    """
    if sys.platform != "linux":
        raise BadTest("a fleet of processes can be had on Linux only; `virtual_fleet` is one in virtual time")
    checked_fleet = check_fleet(fleet) if isinstance(fleet, Fleet) else load_checked_fleet(Path(fleet))
    return LiveTestbed(checked_fleet, check=check)
