"""How the execution of a job ends, and what ends it early."""

from dataclasses import dataclass

from orchestrator.model.errors import TuttiError
from orchestrator.model.report import JobReport, JobState


class JobInterrupted(TuttiError):
    """The reason to end a running job: the state to end in, why, and the originator."""

    def __init__(self, state: JobState, reason: str, actor: str) -> None:
        super().__init__(reason)
        self.state: JobState = state
        self.reason = reason
        self.actor = actor


@dataclass(frozen=True, slots=True)
class JobOutcome:
    """The end of a job's execution.

    begun: False when its axes were taken, its plan is not the approved one (deviates), or the journal could not be
    written (trouble), before it could begin; then it waits again.
    """

    state: JobState
    reason: str
    actor: str
    report: JobReport
    begun: bool = True
    deviates: bool = False
    trouble: bool = False
