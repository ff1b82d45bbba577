"""What is known of a job that has ended: its definition, its report, the recording of its last motion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.forecast import AxisForecast
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport, PointRecord, QueueEntry, StepRecording
from orchestrator.model.steps.order import StepOrder, StepPlace


@dataclass(frozen=True, slots=True)
class EndedJob:
    """A job that has ended, and the fleet as it is now.

    job: with quantities in the place of named positions. recording: of the last step of the report; point: the last one
    that was recorded of a scan. axes: as they are now; outputs: their present levels, by `controller.output`.
    rests: the newest jobs that go on with it already.
    """

    job: Job
    report: JobReport
    recording: StepRecording | None
    point: PointRecord | None
    fleet: Fleet
    axes: Mapping[str, AxisForecast]
    outputs: Mapping[str, bool]
    rests: Sequence[QueueEntry] = ()

    @property
    def order(self) -> StepOrder:
        """Its steps in their order."""
        return StepOrder(self.job.steps, self.report.repeat)


@dataclass(frozen=True, slots=True)
class LastStep:
    """The step at which a job stood. is_under_way: its report says that it had begun; otherwise it is the next one
    behind what was done, and may have begun all the same, as nothing is reported of a step that was cancelled."""

    place: StepPlace
    is_under_way: bool


def find_last_step(ended: EndedJob) -> LastStep:
    """The step at which a job stood. Raises `Refusal`, codes `done` and `nothing-left`."""
    report, order = ended.report, ended.order
    if report.state == "done":
        raise Refusal("done", f"job {report.job_id} is done: nothing of it is left", "submit it again, or retry it")
    index, is_under_way = report.from_step, False
    if report.steps:
        last = report.steps[-1]
        is_under_way = last.state != "done"
        # A re-run from a point has the number of the whole scan.
        index = last.index if is_under_way else max(last.index, report.from_step) + last.steps_done
    if index >= len(order):
        text = f"job {report.job_id} has done all its steps: nothing of it is left"
        raise Refusal("nothing-left", text, "submit it again, or retry it")
    return LastStep(order.locate(index), is_under_way)
