"""Outputs with triggers in the fault campaign: their true edges, against the steps that switch them."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from orchestrator.campaign.records import CampaignPhase, PhaseRecords, StepRecord
from orchestrator.campaign.stages.fleet_parts import TRIGGER_NUMBER, TRIGGER_OUTPUT
from orchestrator.campaign.stages.flown_scans import find_flown_scan
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.report import JobReport, StepReport
from orchestrator.runtime.virtual.fleet import VirtualFleet

EARLY_NS, LATE_NS = 5 * NS_PER_MS, 15 * NS_PER_MS
"""Of an edge, before T0 and after the end of the motion: its instant is rounded to a sample, and commands take time."""
STOPPED_BY_ITSELF = ("limit", "stall")
NOTICED_NS = 200 * NS_PER_MS
"""After the end of an axis that its controller has stopped by itself: the adapter has noticed it, and stopped the
rest."""

AddViolation = Callable[[str, str], None]


class TriggerChecker:
    """Notes when outputs become active, and checks that against steps and reports."""

    def __init__(self, fleet: VirtualFleet, records: PhaseRecords, add_violation: AddViolation) -> None:
        self._fleet = fleet
        self._records = records
        self._add_violation = add_violation
        self._rises: dict[str, list[int]] = {}
        for name, config in fleet.fleet.controllers.items():
            if TRIGGER_OUTPUT in config.outputs:
                self._rises[name] = []
                fleet.controllers[name].on_output(partial(self._note_edge, name))

    @property
    def rises(self) -> Mapping[str, Sequence[int]]:
        """When outputs became active in the present phase, host ns, by controller."""
        return self._rises

    def _note_edge(self, name: str, number: int, level: bool) -> None:  # noqa: FBT001 - as simulators call it
        if number == TRIGGER_NUMBER and level:
            self._rises[name].append(self._fleet.clock.now_ns())

    def check_phase(
        self,
        phase: CampaignPhase,
        steps: Sequence[StepRecord],
        reports: Mapping[str, JobReport | None],
        untrusted: set[str],
    ) -> None:
        """Check invariant 16 for all edges of a phase."""
        for name, rises in self._rises.items():
            begun_steps = [step for step in steps if step.t0_ns is not None and name in step.axes]
            instants: dict[tuple[str, int], list[int]] = {}
            for at_ns in rises:
                step = next(
                    (
                        record
                        for record in reversed(begun_steps)
                        if record.t0_ns is not None and record.t0_ns - EARLY_NS <= at_ns
                    ),
                    None,
                )
                if step is None:
                    self._add_violation("16", f"an output of {name} is active before any step, at {at_ns}")
                    continue
                instants.setdefault((step.job, step.index), []).append(at_ns)
                names = self._find_ending_members(phase, step, reports.get(step.job), name)
                end_ns = self._find_end_ns(phase, names, step)
                late_ns = NOTICED_NS if phase.fault.name in STOPPED_BY_ITSELF else LATE_NS
                if end_ns is None or at_ns > end_ns + late_ns:
                    text = f"an output of {name} is active at {at_ns}, after the end of its step at {end_ns}"
                    self._add_violation("16", text)
            if name not in untrusted:
                for job_id, report in reports.items():
                    # A flight that was interrupted has several motions: what is published of each is compared there.
                    is_flown = find_flown_scan(phase.jobs[job_id].job) is not None
                    for step_report in report.steps if report is not None and not is_flown else ():
                        self._check_rows(name, step_report, instants.get((job_id, step_report.index), []))
            rises.clear()
            if self._fleet.controllers[name].output_level(TRIGGER_NUMBER):
                self._add_violation("16", f"an output of {name} is still active after all jobs")

    def _find_ending_members(
        self, phase: CampaignPhase, step: StepRecord, report: JobReport | None, name: str
    ) -> Sequence[str]:
        """The members behind whose motion an output of a member is passive: all of a step that was done, and of a
        flight, in whose lines the axes of the member may rest."""
        is_done = any(step.index == index for index, _ in self._records.completed_steps(report))
        is_flown = find_flown_scan(phase.jobs[step.job].job) is not None
        return list(step.axes) if is_done or is_flown else [name]

    def _find_end_ns(self, phase: CampaignPhase, names: Sequence[str], step: StepRecord) -> int | None:
        """When the axes of controllers came to rest in a step; None: they did not move."""
        assert step.t0_ns is not None
        ends = [
            motion.end_ns if motion.end_ns is not None else self._fleet.clock.now_ns()
            for name in names
            for axis in step.axes.get(name, ())
            for motion in self._records.find_motions(phase, name, axis, (step.job, step.index), step.t0_ns)
        ]
        return max(ends, default=None)

    def _check_rows(self, name: str, step: StepReport, rises: Sequence[int]) -> None:
        """Check that every row of evidence is of a true edge, which is inside its interval."""
        origin_ns = self._records.origin_ns()
        for triggered_report in step.triggers:
            if triggered_report.output != f"{name}.{TRIGGER_OUTPUT}":
                continue
            if triggered_report.seen > len(rises):
                self._add_violation(
                    "16", f"{triggered_report.output}: {triggered_report.seen} edges, and {len(rises)} have happened"
                )
            for row, at_ns in zip(triggered_report.rows, rises, strict=False):
                if row.seen is not None and not row.seen.earliest_ns <= at_ns - origin_ns <= row.seen.latest_ns:
                    self._add_violation(
                        "16", f"{triggered_report.output}: edge {row.number} at {at_ns - origin_ns}, claimed {row.seen}"
                    )
