"""A recorder of what coordinators publish of points and triggers while a job runs."""

from dataclasses import dataclass, field

from orchestrator.model.operation.recording import JobPoints, RecordedTriggers
from orchestrator.model.report import PointRecord, TriggerRow


@dataclass(frozen=True, slots=True)
class PublishedRows:
    """The rows of one job, in the order in which they were published. triggers: by output."""

    points: list[PointRecord] = field(default_factory=list[PointRecord])
    triggers: dict[str, list[TriggerRow]] = field(default_factory=dict[str, list[TriggerRow]])


class RowRecorder:
    """Records rows by job."""

    def __init__(self) -> None:
        self._jobs: dict[str, PublishedRows] = {}

    def note_publication(self, key: str, payload: bytes) -> None:
        """A coordinator publishes."""
        *_, kind, job_id, last = ["", "", *key.split("/")]
        if kind != "job" or last not in ("points", "triggers"):
            return
        rows = self._jobs.setdefault(job_id, PublishedRows())
        if last == "points":
            rows.points.extend(JobPoints.model_validate_json(payload).rows)
        else:
            triggers = RecordedTriggers.model_validate_json(payload)
            rows.triggers.setdefault(triggers.output, []).extend(triggers.rows)

    def find_rows(self, job_id: str) -> PublishedRows:
        """What was published of a job."""
        return self._jobs.get(job_id, PublishedRows())
