"""Records of the journal, read one by one: a damaged one is shown as a failed job, and the others are not affected."""

from typing import Literal, NamedTuple

from orchestrator.model.errors import TuttiError
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import JobState

UNREADABLE_TIME = "1970-01-01T00:00:00.000000Z"  # stands for one that cannot be read
BRING_BACK = "end the fleet, and bring back a backup: `tutti journal import FILE --state DIR --replace`"
BRING_BACK_DATABASE = (
    "end its coordinators, and bring back a backup, or its own export: "
    "`tutti journal import FILE --journal ADDRESS --replace --connect ROUTER`"
)
"""With the router, the epoch is above all that controllers have seen."""


class JournalError(TuttiError):
    """The journal cannot be used; nothing in it has been changed. Names the file and the remedy."""

    def __init__(self, text: str, remedy: str = "") -> None:
        super().__init__(f"{text}; {remedy}" if remedy else text)
        self.text = text
        self.remedy = remedy


class BadBackup(JournalError):
    """A file to import that is no backup or export, or no whole one. Names the file, the place, and the remedy."""


class JobHasEnded(JournalError):
    """The job has been ended by another coordinator. The journal stays as it is."""


class EpochOvertaken(JobHasEnded):
    """Another coordinator leads; this one must not change its jobs."""


class DamagedRecord(JournalError):
    """One record of the journal cannot be read. The others can."""


class UnknownResult(JournalError):
    """The journal was asked to store something, and gave no answer in time: it may be stored or not. A request with the
    same key finds out."""


class CopyMissing(JournalError):
    """A copy of the journal that the fleet asks for is missing. Nothing was stored."""


class HistoryLost(JournalError):
    """The journal is older than what adapters have seen of it: what it does not know may have been done."""


class JobRecord(NamedTuple):
    """A job in the journal.

    after: the job that must be done before. due: it has no start time, or that time has come. held_by: originator of
    the hold, if it is held. origin: the job that it re-runs, from step `from_step` on. continues:
    the job that it goes on with. damage: what cannot be read of
    it; the other values are then those of a failed job.
    """

    id: str
    name: str
    actor: str
    state: JobState
    reason: str
    submitted_utc: str
    priority: int
    place: int
    repeat: int
    after: str | None
    at_utc: str | None
    missed: Literal["run", "skip"]
    due: bool
    held_by: str
    origin: str | None
    from_step: int
    expires_utc: str | None = None
    now: bool = False
    session: str | None = None
    proposed: bool = False
    continues: str | None = None
    damage: str = ""

    @property
    def terms(self) -> QueueTerms:
        return QueueTerms(
            priority=self.priority,
            repeat=self.repeat,
            after=self.after,
            at=self.at_utc,
            missed=self.missed,
            held=bool(self.held_by),
            now=bool(self.now),
            expires=self.expires_utc,
            session=self.session,
            proposed=bool(self.proposed),
            continues=self.continues,
        )
