"""A fleet in virtual time for tests and scripts: each call runs until it is done, and time goes on only meanwhile.

with virtual_fleet("lab.fleet.yaml", seed=1) as fleet:
    fleet.tutti.home()
    fleet.fail("stage", "power-off", at="2 s")
    ...
"""

import json
from collections.abc import Callable, Coroutine
from contextvars import Context
from functools import partial
from pathlib import Path
from random import Random
from typing import Any, TypeVar

from orchestrator.client.api import Tutti
from orchestrator.client.blocking import BlockingTutti
from orchestrator.client.worker import BlockingObject
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, VirtualLoop
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.checked import check_fleet, load_checked_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet
from orchestrator.testing.checks import REPAIR_NS, RunChecks
from orchestrator.testing.client_bus import ClientBus, JogNotes
from orchestrator.testing.errors import (
    BadTest,
    FleetViolation,
    find_axis,
    format_s,
    parse_delay_ns,
)
from orchestrator.testing.fault_schedule import FaultSchedule, InjectedFault
from orchestrator.testing.testbed import FleetTestbed, call_scheduled
from orchestrator.testing.truth import SAMPLE_NS, AxisTruth, MotorRecord
from orchestrator.testing.virtual_worker import VirtualWorker
from sim.core.contact import ContactBench
from sim.core.controller import CommandedMotion
from sim.link.world import change_environment

T = TypeVar("T")

VELOCITY_SAMPLES = 20  # samples from one check of the velocities to the next


class _VirtualTutti(BlockingTutti):
    """A client whose calls run the virtual loop."""

    def __init__(self, tutti: Tutti, worker: VirtualWorker) -> None:
        BlockingObject.__init__(self, tutti, worker)  # pyright: ignore[reportUnknownMemberType]
        self._closed = False


class _VirtualTruth(AxisTruth):
    def __init__(self, name: str, testbed: "VirtualTestbed") -> None:
        controller, axis = find_axis(testbed.fleet, name)
        super().__init__(name, axis, testbed.origin_ns)
        self._record = testbed.find_record(controller, axis.motors[0])
        self._clock = testbed.clock

    def _find_motions(self) -> list[CommandedMotion]:
        return self._record.motions

    def _find_counts(self, at_ns: int) -> float:
        self._require_past(at_ns, self._clock.now_ns())
        self._record.take_sample(self._clock.now_ns())
        return self._record.find_counts(at_ns)


class VirtualTestbed(FleetTestbed):
    """A simulated fleet in virtual time. Made by `virtual_fleet`; use it as a context.

    fleet: its fleet file. seed: all that is random is drawn from it. tutti: a client; each of its calls runs the fleet
    until the call is done.
    """

    def __init__(self, fleet: Fleet, seed: int, limit_ns: int, *, check: bool) -> None:
        super().__init__(fleet, check=check)
        self.seed = seed
        self.clock = VirtualClock(VirtualLoop())
        self._worker = VirtualWorker(self.clock.loop, limit_ns)
        self._virtual = VirtualFleet(fleet, self.clock, seed)
        self._contacts = ContactBench(self.clock)
        self._checks = RunChecks(self._virtual, self.clock)
        self._jogs = JogNotes(fleet)
        self._faults = FaultSchedule(self._virtual, self.clock, self._worker, Random(f"faults {seed}"))
        self._records = {
            (name, axis.motors[0]): MotorRecord(self._virtual.controllers[name], axis.motors[0])
            for name, config in fleet.controllers.items()
            for axis in config.axes.values()
        }
        self._tutti: BlockingTutti | None = None

    def __repr__(self) -> str:
        return f"<virtual fleet {self.fleet.fleet}, seed {self.seed}, at {format_s(self.clock.now_ns())}>"

    # Begin and end

    def _start(self) -> None:
        Context().run(self.clock.loop.create_task, self._take_samples())
        self._worker.run_coroutine(self._virtual.start())
        self.origin_ns = next(iter(self._virtual.coordinators.values()))[1].leadership.scale.origin_host_ns
        self._tutti = self.connect("test")

    def _end(self) -> None:
        self.clock.loop.close()
        self._virtual.journal.close()

    def check(self) -> None:
        """Repair all faults, wait for rest, and check the invariants against the true motions.

        Raises `FleetViolation`. The end of the context does it, unless `check=False` was given.
        """
        violations = self._worker.run_coroutine(self._check_run())
        if violations:
            head = f"fleet {self.fleet.fleet}, seed {self.seed}: {len(violations)} violations of invariants"
            raise FleetViolation("\n  ".join([head, *violations]))

    async def _check_run(self) -> list[str]:
        if any(not fault.over for fault in self._faults.faults):
            await self._faults.end_all()
            await sleep_ns(self.clock, REPAIR_NS)
        return await self._checks.check_run(self._faults.faults, self._jogs.jogs)

    async def _take_samples(self) -> None:
        samples = 0
        while True:
            for record in self._records.values():
                record.take_sample(self.clock.now_ns())
            if samples % VELOCITY_SAMPLES == 0:
                self._checks.check_velocities()
            samples += 1
            await sleep_ns(self.clock, SAMPLE_NS)

    # Requests

    @property
    def tutti(self) -> BlockingTutti:
        """The client of the test. Raises `BadTest` before the start."""
        if self._tutti is None:
            raise BadTest("the fleet is not started; use it as `with virtual_fleet(…) as fleet:`")
        return self._tutti

    def connect(self, actor: str) -> BlockingTutti:
        """Another client, with the name that its requests have."""
        return _VirtualTutti(self._make_client(actor), self._worker)

    def run(self, main: Callable[[Tutti], Coroutine[Any, Any, T]]) -> T:
        """Run the asynchronous `main(tutti)` to its end, and return its result. Inside, `asyncio.sleep` is virtual."""
        work = main(self._make_client("test"))
        return self._worker.run_limited(work, None)

    def _make_client(self, actor: str) -> Tutti:
        virtual = self._virtual
        plain = virtual.net.join_process(f"{actor}-{virtual.draw_id()[:8]}")
        bus = ClientBus(plain, self._checks.recorder, virtual.keys, self._jogs)
        self._faults.clients.append(bus)
        return Tutti(bus, self.fleet.fleet, actor, virtual.draw_id)

    # Time

    @property
    def now_s(self) -> float:
        """The present instant in fleet time, s, as in reports."""
        return (self.clock.now_ns() - self.origin_ns) / NS_PER_S

    def advance(self, duration: str | float) -> None:
        """Let time go on, by text with a unit or by seconds. Raises `BadTest`."""
        self._worker.run_limited(sleep_ns(self.clock, parse_delay_ns("advance", duration) or 0), None)

    def _call_at(self, function: Callable[[], object], at_ns: int | None) -> None:
        if at_ns is None:
            function()
            return

        due_ns = self.clock.now_ns() + at_ns
        self.clock.call_at_ns(due_ns, partial(call_scheduled, function, due_ns - self.origin_ns), context=Context())

    # The physical environment

    def fail(
        self,
        controller: str | None,
        fault: str,
        *,
        at: str | float | None = None,
        until: str | float | None = None,
    ) -> InjectedFault:
        """Inject a fault of the campaign by its name, now or at a time from now; `.repair()` or `until` ends it.

        controller: the one that it concerns; None for faults of the whole fleet. All are repaired at the end of the
        test. Raises `UnknownName` with all names, `BadTest` for one that the controller cannot have.
        """
        return self._faults.add_fault(controller, fault, parse_delay_ns("at", at), parse_delay_ns("until", until))

    def _change_now(self, controller: str, change: dict[str, object]) -> None:
        line = json.dumps(change)
        self._virtual.act_on_controller(controller, lambda unit: change_environment(unit, line, self._contacts))

    # What has happened

    def truth(self, axis: str) -> AxisTruth:
        """The true motion of `controller.axis`. Raises `UnknownName`."""
        return _VirtualTruth(axis, self)

    def find_record(self, controller: str, motor: str) -> MotorRecord:
        """The record of a motor."""
        return self._records[controller, motor]

    @property
    def log(self) -> list[str]:
        """The event log so far: JSON lines of coordinators and adapter hosts."""
        return self._virtual.lines


def virtual_fleet(
    fleet: Path | str | Fleet, seed: int = 1, *, check: bool = True, limit: str | float = "10 min"
) -> VirtualTestbed:
    """A simulated fleet in virtual time, from a fleet file or a `Fleet`; use it as a context.

    seed: all that is random is drawn from it; equal seeds give equal runs. check: check the invariants at the end.
    limit: of fleet time for one call. Raises `FileError` with every mistake of the file.
    """
    checked_fleet = check_fleet(fleet) if isinstance(fleet, Fleet) else load_checked_fleet(Path(fleet))
    return VirtualTestbed(checked_fleet, seed, parse_delay_ns("limit", limit) or 0, check=check)
