"""Moves of virtual axes in the fault campaign: by truth, they are on their straight line within the stated bound."""

from collections.abc import Callable, Collection, Mapping, Sequence

from orchestrator.campaign.records import CampaignPhase, PhaseRecords
from orchestrator.campaign.stages.fleet_parts import VIRTUAL_GROUP
from orchestrator.campaign.stages.virtual_moves import find_virtual_move
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.model.names import controller_of
from orchestrator.model.report import FINISHED_STATES, JobReport, StepReport, VirtualBound
from orchestrator.model.steps.move import Move
from orchestrator.model.virtual_maps import VirtualMap
from orchestrator.runtime.virtual.fleet import VirtualFleet

SAMPLE_NS = 5 * NS_PER_MS  # of moving axes
REST_NS = 50 * NS_PER_MS  # between two looks at axes at rest
EARLY_NS = NS_PER_S  # before T0 axes have stood where the line begins
AddViolation = Callable[[str, str], None]
_Sample = tuple[int, tuple[float, ...]]
"""An instant, host ns, and the true virtual positions then."""


class VirtualLineChecker:
    """Watches the virtual axes of a fleet while a job moves them. add_violation: called with the invariant and a
    text."""

    def __init__(self, fleet: VirtualFleet, records: PhaseRecords, add_violation: AddViolation) -> None:
        self._fleet = fleet
        self._records = records
        self._add_violation = add_violation
        self._samples: dict[str, list[_Sample]] = {}
        self._tasks = TaskOwner()

    # During a run

    def watch(self, phase: CampaignPhase) -> None:
        """Watch the virtual axes of a phase's jobs from now on, each until its job has ended."""
        for job_id, order in phase.jobs.items():
            if find_virtual_move(order.job) is not None and job_id not in self._samples:
                samples = self._samples[job_id] = list[_Sample]()
                self._tasks.spawn(self._sample(job_id, samples))

    def end(self) -> None:
        """Watch no more."""
        self._tasks.cancel_all()

    async def _sample(self, job_id: str, samples: list[_Sample]) -> None:
        virtual_map = self._map
        units = {axis: self._fleet.controllers[controller_of(axis)] for axis in virtual_map.real}
        configs = {axis: self._fleet.fleet.axis(axis) for axis in virtual_map.real}
        while (row := self._fleet.journal.load_record(job_id)) is not None and row.state not in FINISHED_STATES:
            moves = True
            while moves:
                real = [configs[axis].to_unit(units[axis].position(configs[axis].motors[0])) for axis in units]
                samples.append((self._fleet.clock.now_ns(), virtual_map.observe(real)))
                moves = any(units[axis].is_moving(configs[axis].motors[0]) for axis in units)
                await sleep_ns(self._fleet.clock, SAMPLE_NS if moves else REST_NS)

    @property
    def _map(self) -> VirtualMap:
        return self._fleet.fleet.virtual_axes.maps[VIRTUAL_GROUP]

    # After a phase

    def check_phase(
        self, phase: CampaignPhase, reports: Mapping[str, JobReport | None], untrusted: Collection[str]
    ) -> None:
        """Check invariant 19 for the moves of virtual axes in a phase, until a fault interrupts them. untrusted:
        controllers whose links and crystals are outside the model."""
        for job_id, report in reports.items():
            samples = self._samples.pop(job_id, [])
            move = find_virtual_move(phase.jobs[job_id].job)
            if move is None or report is None or {controller_of(axis) for axis in self._map.real} & set(untrusted):
                continue
            for step in report.steps:
                if step.virtual and step.t0_fleet_ns is not None:
                    self._check_step(phase, step, move, samples)

    def _check_step(self, phase: CampaignPhase, step: StepReport, move: Move, samples: Sequence[_Sample]) -> None:
        assert step.t0_fleet_ns is not None
        t0_ns = step.t0_fleet_ns + self._records.origin_ns()
        fault_ns = phase.fault_ns
        is_interrupted = fault_ns is not None and not phase.fault.harmless and t0_ns < fault_ns
        begins = [virtual for at_ns, virtual in samples if t0_ns - EARLY_NS < at_ns < t0_ns]
        way = [
            (at_ns, virtual)
            for at_ns, virtual in samples
            if at_ns >= t0_ns and not (is_interrupted and fault_ns is not None and at_ns > fault_ns)
        ]
        if not begins:
            return
        targets = [float(move.to[name]) for name in self._map.virtual]
        bounds = [step.virtual[name] for name in self._map.virtual]
        for at_ns, virtual in way:
            if not _is_on_line(virtual, begins[0], targets, bounds):
                text = f"{VIRTUAL_GROUP} is off its line by more than its bound, at {virtual}, from {begins[0]}"
                self._add_violation("19", f"{text} to {targets}, {(at_ns - t0_ns) / NS_PER_S:.3f} s after T0")
                return


def _is_on_line(
    virtual: Sequence[float], begin: Sequence[float], end: Sequence[float], bounds: Sequence[VirtualBound]
) -> bool:
    """Whether some point of a line has all positions within their bounds: the shares of the way for which one has form
    an interval, and these have one in common."""
    least, most = 0.0, 1.0
    for value, first, last, bound in zip(virtual, begin, end, bounds, strict=True):
        distance, way = value - first, last - first
        if not way:
            if abs(distance) > bound.most:
                return False
            continue
        ends = ((distance - bound.most) / way, (distance + bound.most) / way)
        least, most = max(least, min(ends)), min(most, max(ends))
    return least <= most
