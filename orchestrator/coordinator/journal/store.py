"""What a journal keeps, by facts. SQLite keeps it on disk (`sqlite/`); the coordinator knows only this."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Protocol

from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.facts import (
    AlarmChange,
    AlarmNotice,
    KeyedJob,
    QueueEntryOptions,
    Reservation,
    StatisticsRow,
    StepDecision,
    UploadState,
)
from orchestrator.coordinator.journal.records import JobRecord
from orchestrator.model.jobs.job import Job
from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.model.operation.approval import JobApproval
from orchestrator.model.operation.commands import CommandRecord
from orchestrator.model.operation.learned import LearnedTimes
from orchestrator.model.positions.entries import SavedPosition
from orchestrator.model.queue import QueueStop
from orchestrator.model.report import JobReport, JobState, JobTransition, PointRecord, StepRecording
from orchestrator.model.steps.points import PointAxis


class PointRowStore(Protocol):
    """What was recorded at the points of scans."""

    def store_points(self, job_id: str, points: Sequence[PointRecord]) -> None:
        """Store points of a job. Raises `JournalError`."""
        ...

    def load_points(self, job_id: str, after: tuple[int, int], limit: int) -> list[PointRecord]:
        """Up to `limit` points in their order, those after (step, point). Raises `JournalError`."""
        ...


class PointUploads(Protocol):
    """Points of scans that clients have sent before the jobs that name them."""

    def begin_upload(
        self, digest: str, axes: Sequence[PointAxis], count: int, utc: str, named: Collection[str]
    ) -> UploadState:
        """Begin, or continue, to store `count` points. named: digests that jobs name. Raises `Refusal`, code
        `point-store-full`."""
        ...

    def find_upload(self, digest: str, utc: str) -> UploadState | None:
        """The state of an upload, which counts as used now; None for an unknown digest."""
        ...

    def add_part(self, digest: str, begin: int, data: bytes, utc: str) -> UploadState:
        """Add the bytes from `begin` on. A part that is not the next one changes nothing.

        Raises `Refusal` for an upload that is not known, and with the last part for a wrong digest, or a point that is
        not finite."""
        ...

    def read_rows(self, digest: str, first: int, count: int) -> list[tuple[float, ...]]:
        """Up to `count` points from number `first` on. Raises `JournalError`, also where they are not stored."""
        ...

    @property
    def used_bytes(self) -> int:
        """The bytes of all points, with those of uploads that have begun."""
        ...

    def delete_upload(self, digest: str) -> None:
        """Delete points."""
        ...

    def delete_unused(self, named: Collection[str], utc: str) -> None:
        """Delete points that no job names and that were not used for an hour."""
        ...


class AlarmJournal(Protocol):
    """Alarms, their history, and notices that are pending. Every method raises `JournalError`."""

    def store_changes(self, changes: Sequence[AlarmChange], forgotten: Iterable[str] = ()) -> None:
        """Store changes in their order, with the notices of them; and delete alarms by id. Of the history, the newest
        changes are kept."""
        ...

    def store_tries(self, change: str, tries: int) -> None:
        """Record how often the command for a notice has failed."""
        ...

    def delete_notice(self, change: str) -> None:
        """Record that a notice is done with."""
        ...

    def load_alarms(self) -> tuple[list[AlarmRecord], list[str]]:
        """The alarms, and the ids of those that are damaged."""
        ...

    def load_notices(self) -> list[AlarmNotice]:
        """The pending notices, the oldest first; without damaged ones."""
        ...

    def load_history(self, limit: int) -> list[AlarmRecord]:
        """The newest changes, the newest first; without damaged ones."""
        ...


class StatisticsStore(Protocol):
    """Figures by day, kind and subject. Every method raises `JournalError`."""

    def add_rows(self, rows: Iterable[StatisticsRow]) -> None:
        """Add the values of rows to the figures."""
        ...

    def read_rows(self, since_day: str) -> list[StatisticsRow]:
        """All figures from a day on, in the order of day, kind, subject and figure."""
        ...


class LearnedStore(Protocol):
    """What was learned of the times of controllers. Every method raises `JournalError`."""

    def save_times(self, times: Iterable[LearnedTimes]) -> None:
        """Keep learned times, in the place of earlier ones of the same controllers."""
        ...

    def load_times(self) -> list[LearnedTimes]:
        """All learned times that are not damaged."""
        ...

    def forget_times(self, controllers: Iterable[str]) -> None:
        """Delete the learned times of controllers."""
        ...


class ApprovalStore(Protocol):
    """The last approval of each proposed job. Every method raises `JournalError`."""

    def approve_job(self, approval: JobApproval, transition: JobTransition) -> bool:
        """Store an approval, and release its job if it waits for one. False: the job is not queued any more, and
        nothing has changed."""
        ...

    def void_approval(self, job_id: str, transition: JobTransition) -> None:
        """Hold a job again, for the reason of the transition, for which its approval is void from now on. A job that is
        not queued any more is not changed."""
        ...

    def load_approval(self, job_id: str) -> JobApproval | None:
        """The last approval of a job, also one that is void. Raises `DamagedRecord` for one that cannot be read."""
        ...


class CommandStore(Protocol):
    """The newest commands of users. Every method raises `JournalError`."""

    def store_command(self, command: CommandRecord) -> None:
        """Store a command, and delete the oldest ones."""
        ...

    def list_commands(self, limit: int, before_utc: str | None = None, by: str = "") -> list[CommandRecord]:
        """The newest commands, the newest first: those before an instant, by users with `by` in their name."""
        ...


class JournalStore(Protocol):
    """The journal of one fleet. Every method that changes something has stored it safely when it returns; every method
    raises `JournalError` where the journal cannot be used: nothing is stored then, but with `UnknownResult`."""

    @property
    def point_rows(self) -> PointRowStore: ...

    @property
    def points(self) -> PointUploads: ...

    @property
    def alarms(self) -> AlarmJournal: ...

    @property
    def statistics(self) -> StatisticsStore: ...

    @property
    def learned(self) -> LearnedStore: ...

    @property
    def approvals(self) -> ApprovalStore: ...

    @property
    def commands(self) -> CommandStore: ...

    def close(self) -> None: ...

    def run_group(self, calls: Sequence[JournalCall], epoch: int) -> None:
        """Run calls of this journal in their order. Those that change it are one commit; if that fails, each is run
        alone, so that each has its own result or error. If an epoch after `epoch` has been taken, nothing is run, and
        this, or each call, has the error `EpochOvertaken`."""
        ...

    def take_epoch(self, seen: int) -> int:
        """Take the next epoch: above the last one here and above `seen`, in one transaction.

        seen: of other coordinators and adapters; one that is far from the last one here is no real one, and is ignored.
        """
        ...

    def require_latest_epoch(self, epoch: int) -> None:
        """Raises `EpochOvertaken` if an epoch after `epoch` has been taken."""
        ...

    def fleet_time_scale(self, kernel_id: str, now_ns: int, scale_id: str) -> tuple[str, int]:
        """(scale id, origin in host ns): those of the last leader on this kernel, else a new scale from `now_ns`."""
        ...

    def load_queue_stop(self) -> QueueStop | None:
        """Why no job of the queue begins; None: jobs begin."""
        ...

    def store_queue_stop(self, stop: QueueStop | None) -> None:
        """Record that the queue is stopped, or started (None)."""
        ...

    def load_instances(self) -> dict[str, str]:
        """The adapter instance of each controller, as the last leader saw them."""
        ...

    def store_instances(self, instances: Mapping[str, str]) -> None: ...

    def accept_job(
        self, job_id: str, client_key: str, job: Job, utc: str, entry: QueueEntryOptions | None = None
    ) -> tuple[str, bool]:
        """Accept a job: (its id, whether it is new). The same `client_key` of the same owner returns the same job."""
        ...

    def find_keyed_job(self, owner: str, client_key: str) -> KeyedJob | None:
        """The job that was accepted with that key of that owner. Keys of schema 10 and before had none: they count for
        all."""
        ...

    def record_transition(self, job_id: str, transition: JobTransition) -> None:
        """Record a change of a job's state. Raises `JobHasEnded`, `JournalError`."""
        ...

    def record_end(self, job_id: str, transition: JobTransition, report: JobReport) -> JobReport:
        """Record the end of a job with its report, which gets all its transitions. Returns the report. Raises
        `JobHasEnded`, `JournalError`."""
        ...

    def hold_jobs(self, job_ids: Iterable[str], held_by: str, transition: JobTransition) -> None:
        """Record the originator of a hold; empty: released. Jobs that are not queued any more are not changed."""
        ...

    def mark_due(self, job_id: str, transition: JobTransition) -> None:
        """Record that the start time of a job has come. A job that is not queued any more is not changed."""
        ...

    def reorder_jobs(self, job_id: str, priority: int, places: Mapping[str, int], transition: JobTransition) -> None:
        """Change the places of jobs, and the priority of `job_id`. Nothing changes if that is not queued any more."""
        ...

    def record_decision(self, job_id: str, decision: StepDecision, utc: str) -> None:
        """Record that all members have promised: from here on the step may move.

        Raises `JobHasEnded`, `JournalError`."""
        ...

    def withdraw_decision(self, job_id: str, step: int, t0_fleet_ns: int) -> None:
        """Withdraw a decision: no member has started, and none will at that T0.

        Raises `JobHasEnded`, `JournalError`."""
        ...

    def list_decisions(self, job_id: str) -> list[tuple[int, int]]:
        """(step, T0 in fleet ns) of every decision to move in a job."""
        ...

    def load_job(self, job_id: str) -> Job | None: ...

    def load_job_body(self, job_id: str) -> str | None:
        """The JSON of a job, which takes long to decode if the job is large."""
        ...

    def load_record(self, job_id: str) -> JobRecord | None: ...

    def list_unfinished(self) -> list[JobRecord]:
        """Jobs that are queued or were running, in the order in which they are to begin; also those whose state is
        damaged."""
        ...

    def fail_damaged(self, job: JobRecord, transition: JobTransition, report: JobReport) -> None:
        """End a job that cannot be read, so that the others can be run."""
        ...

    def find_jobs(
        self, limit: int, state: JobState | None = None, name: str = "", since_utc: str = "", before_id: str = ""
    ) -> tuple[list[JobRecord], int]:
        """The newest jobs, newest first, and the total number: in `state`, with `name` in their name, submitted at
        `since_utc` or later, and before the job `before_id`."""
        ...

    def find_referenced_jobs(self, reference: str, limit: int = 5) -> list[JobRecord]:
        """The job with this id; else those whose id begins so; else those of this name. The newest first."""
        ...

    def list_transitions(self, job_id: str) -> list[JobTransition]: ...

    def load_report(self, job_id: str) -> JobReport | None: ...

    def prune_jobs(self, before_utc: str, keep: int) -> int:
        """Delete jobs that were submitted before `before_utc` and have ended, except the newest `keep`, and except
        those that a queued job comes after. Returns how many. Their client keys are deleted too."""
        ...

    def list_named_points(self) -> set[str]:
        """The digests of the stored points that jobs name."""
        ...

    def store_recording(self, job_id: str, recording: StepRecording) -> None:
        """Store the recording of a step, and delete recordings of old jobs, and the oldest ones of a long job."""
        ...

    def load_recording(self, job_id: str, step: int) -> StepRecording | None: ...

    def store_reservation(self, holder: str, actor: str, what: str, axes: Iterable[str], until_utc: str) -> None:
        """Record axes that are reserved for work at the machine."""
        ...

    def delete_reservation(self, holder: str) -> None:
        """Record that they have been released."""
        ...

    def list_reservations(self) -> list[Reservation]: ...

    def store_position(self, position: SavedPosition) -> None:
        """Store a saved position; one of the same name is replaced."""
        ...

    def delete_position(self, name: str) -> None: ...

    def list_positions(self) -> tuple[list[SavedPosition], list[str]]:
        """The saved positions in the order of their names, and the names of those that are damaged."""
        ...
