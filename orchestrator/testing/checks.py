"""The invariants of the fleet after a test, checked by the checker of the fault campaign against the true motions.

A test may do anything: stop, cancel, press switches, inject faults. So those that hold for every run are checked: 1, 2,
5 to 8 and 12 of the reference, of 3 that all axes come to rest soon after their job, and that each job has ended once.
"""

from collections.abc import Sequence
from contextlib import suppress

from orchestrator.campaign.faults import FaultKind
from orchestrator.campaign.invariants import InvariantChecker
from orchestrator.campaign.jobs import JobOrder
from orchestrator.campaign.recording.recorder import BusRecorder
from orchestrator.campaign.recording.rest import find_at_rest
from orchestrator.campaign.records import CampaignPhase, JogRecord
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock
from orchestrator.coordinator.journal.records import DamagedRecord
from orchestrator.model.jobs.job import Job
from orchestrator.model.names import controller_of
from orchestrator.model.report import FINISHED_STATES
from orchestrator.model.steps.tree import iterate_steps
from orchestrator.runtime.virtual.fleet import VirtualFleet
from orchestrator.testing.fault_schedule import InjectedFault

MAX_JOBS = 100_000
SETTLE_NS = NS_PER_S  # after the last call of a test: what has begun to stop comes to rest
REPAIR_NS = 3 * NS_PER_S  # after the repair of faults: it is detected, and answered

_ANY_RUN = FaultKind("test", "fleet", must_stop=False)
"""Stands for all that a test may do: no job has to be done, and none has to stop."""


class RunPhase(CampaignPhase):
    """A whole test as one phase. faults: those that were injected."""

    __slots__ = ("faults",)
    faults: Sequence[InjectedFault]

    @property
    def unstoppable(self) -> set[str]:
        """Controllers that could not be stopped for a while."""
        kept_faults = [
            fault for fault in self.faults if fault.begun and (fault.kind.unstoppable or fault.kind.reach == "power")
        ]
        return {name for fault in kept_faults for name in fault.affected}


class RunChecks:
    """Checks one virtual fleet. Made before it starts."""

    def __init__(self, fleet: VirtualFleet, clock: VirtualClock) -> None:
        self.recorder = BusRecorder(clock, lambda _: None)
        self._fleet = fleet
        self._clock = clock
        fleet.wrap_bus = self.recorder.wrap_bus
        self._checker = InvariantChecker(fleet, self.recorder)

    def check_velocities(self) -> None:
        """Check the present velocities against the limits of the axes."""
        self._checker.check_velocities(self._clock.now_ns())

    async def check_run(self, faults: Sequence[InjectedFault], jogs: Sequence[JogRecord]) -> list[str]:
        """Wait for rest, check all that has happened, and return the violations."""
        await sleep_ns(self._clock, SETTLE_NS)
        names = list(self._fleet.fleet.controllers)
        phase = RunPhase(_ANY_RUN, names[0], names, dict.fromkeys(names, 0))
        phase.faults = faults
        phase.fault_ns = 0
        phase.jogs.extend(jogs)
        phase.at_rest = await find_at_rest(self._fleet, self._clock)
        for fault in faults:
            if fault.begun:
                self._checker.note_fault(fault.kind, fault.controller, fault.affected)
        self._add_jobs(phase)
        self._checker.check_phase(phase)
        return list(dict.fromkeys(self._checker.violations))

    def _add_jobs(self, phase: CampaignPhase) -> None:
        """Add all jobs of the journal but those that wait, of which nothing must have begun."""
        journal = self._fleet.journal
        for row in reversed(journal.find_jobs(MAX_JOBS)[0]):
            if row.state == "queued":
                if journal.list_decisions(row.id):
                    self._checker.add_violation("6", f"job {row.name} waits in the queue, and has moved axes before")
                continue
            if row.state not in FINISHED_STATES:
                text = f"job {row.name} is still {row.state} at the end of the test; wait for it, or stop it"
                self._checker.add_violation("6", text)
                continue
            with suppress(DamagedRecord):  # of a disk with flipped bits
                job = journal.load_job(row.id)
                if job is not None:
                    phase.jobs[row.id] = JobOrder(job, row.terms, find_controllers(job, phase.affected))


def find_controllers(job: Job, everything: Sequence[str]) -> tuple[str, ...]:
    """The controllers that a job concerns; all of them where it does not name one."""
    names: list[str] = []
    for step in iterate_steps(job.steps):
        names += step.switched_outputs or step.named_axes or step.awaited_inputs or everything
    partitions = {controller_of(name) for name in names}
    return tuple(partitions) if partitions <= set(everything) else tuple(everything)
