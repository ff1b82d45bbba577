"""Pairs in the fault campaign: by truth, their axes are never farther apart than was stated before they moved."""

from collections.abc import Callable, Mapping, Sequence

from orchestrator.campaign.records import CampaignPhase, StepRecord
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.model.names import split_name
from orchestrator.model.report import JobReport
from orchestrator.model.virtual_maps import Pair
from orchestrator.runtime.virtual.fleet import VirtualFleet

SAMPLE_NS = 5 * NS_PER_MS
EARLY_NS = NS_PER_S  # before T0 both have stood where the step begins
TRUTH = 0.01  # units: rounding of both to counts
# Only a wired emergency stop ends a motor whose controller's own program hangs (invariant 22).
UNBOUND_FAULTS = ("firmware-hung", "stall")


class RackChecker:
    """Watches the pairs of a fleet while jobs run. add_violation: called with the invariant and a text."""

    def __init__(self, fleet: VirtualFleet, add_violation: Callable[[str, str], None]) -> None:
        self._fleet = fleet
        self._add_violation = add_violation
        self._samples: dict[str, list[tuple[int, float]]] = {}
        self._tasks = TaskOwner()

    # During a run

    def watch(self) -> None:
        """Watch all pairs from now on; does nothing if they are watched."""
        for group, pair in self._fleet.fleet.virtual_axes.pairs.items():
            if group not in self._samples:
                samples = self._samples[group] = list[tuple[int, float]]()
                self._tasks.spawn(self._sample(pair, samples))

    def end(self) -> None:
        """Watch no more."""
        self._tasks.cancel_all()

    async def _sample(self, pair: Pair, samples: list[tuple[int, float]]) -> None:
        while True:
            first, second = (self._find_place(axis) for axis in pair.real)
            samples.append((self._fleet.clock.now_ns(), first - second))
            await sleep_ns(self._fleet.clock, SAMPLE_NS)

    def _find_place(self, name: str) -> float:
        """Where an axis is by truth, in its unit; no counter that is set changes it."""
        axis, controller = self._fleet.fleet.axis(name), split_name(name)[0]
        return self._fleet.controllers[controller].physical_position(axis.motors[0]) / float(axis.counts_per_unit)

    # After a phase

    def check_phase(
        self, phase: CampaignPhase, steps: Sequence[StepRecord], reports: Mapping[str, JobReport | None]
    ) -> None:
        """Check invariant 22 for the steps of a phase that move a pair, each until the next one or a homing."""
        if phase.fault.name in UNBOUND_FAULTS:
            return
        for job_id, report in reports.items():
            for step in report.steps if report is not None else []:
                for group, bound in step.pairs.items():
                    record = next((own for own in steps if (own.job, own.index) == (job_id, step.index)), None)
                    if record is not None and record.t0_ns is not None:
                        until_ns = self._find_next_begin(steps, record, self._fleet.fleet.virtual_axes.pairs[group])
                        self._check_step(group, record.t0_ns, until_ns, bound.most, phase)
        for samples in self._samples.values():
            samples.clear()

    def _find_next_begin(self, steps: Sequence[StepRecord], step: StepRecord, pair: Pair) -> int:
        """When another step, or a homing, of one of both axes was requested; else when the run is over."""
        members = {split_name(axis)[0] for axis in pair.real}
        requested_ns = (record.requested_ns for record in steps if members & set(record.axes))
        later_ns = (begin_ns for begin_ns in requested_ns if begin_ns > step.requested_ns)
        return min(later_ns, default=self._fleet.clock.now_ns())

    def _check_step(self, group: str, t0_ns: int, until_ns: int, most: float, phase: CampaignPhase) -> None:
        begins = [distance for at_ns, distance in self._samples[group] if t0_ns - EARLY_NS < at_ns < t0_ns]
        racks = [
            (at_ns, abs(distance - begins[-1])) for at_ns, distance in self._samples[group] if t0_ns <= at_ns < until_ns
        ]
        if not begins or not racks:
            return
        at_ns, rack = max(racks, key=lambda sample: sample[1])
        if rack > most + TRUTH:
            moment = f"{(at_ns - t0_ns) / NS_PER_S:.3f} s after T0 ({phase.fault.name} of {phase.member})"
            self._add_violation("22", f"{group} came {rack:.3f} apart {moment}, and {most:.3f} was stated")
