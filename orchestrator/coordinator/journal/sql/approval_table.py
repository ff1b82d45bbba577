"""The approvals of proposed jobs in the journal: the last one of each job, with the plan that was approved."""

from contextlib import suppress
from zlib import crc32

from pydantic import ValidationError

from orchestrator.coordinator.journal.records import DamagedRecord
from orchestrator.coordinator.journal.sql.database import JournalPart, make_upsert
from orchestrator.coordinator.journal.sql.job_states import insert_transition, is_queued
from orchestrator.model.operation.approval import JobApproval
from orchestrator.model.queue import APPROVAL
from orchestrator.model.report import JobTransition

_STORE = make_upsert("approvals", ["job_id"], ["body", "crc"])


class ApprovalTable(JournalPart):
    """`ApprovalStore`: the table of approvals in one database. Every method raises `JournalError`."""

    def approve_job(self, approval: JobApproval, transition: JobTransition) -> bool:
        with self._db.transaction():
            if not is_queued(self._db, approval.job_id):
                return False
            self._store(approval)
            values = (approval.job_id, APPROVAL)
            self._db.write("UPDATE jobs SET held_by = '' WHERE id = ? AND held_by = ?", values)
            insert_transition(self._db, approval.job_id, transition)
        return True

    def void_approval(self, job_id: str, transition: JobTransition) -> None:
        with self._db.transaction():
            if not is_queued(self._db, job_id):
                return
            with suppress(DamagedRecord):  # which counts as none
                approval = self.load_approval(job_id)
                if approval is not None:
                    self._store(approval.model_copy(update={"void": transition.reason}))
            self._db.write("UPDATE jobs SET held_by = ? WHERE id = ?", (APPROVAL, job_id))
            insert_transition(self._db, job_id, transition)

    def load_approval(self, job_id: str) -> JobApproval | None:
        for body, crc in self._db.select("SELECT body, crc FROM approvals WHERE job_id = ?", (job_id,)):
            try:
                approval = JobApproval.read_stored(body)
            except ValidationError:
                approval = None
            if approval is None or approval.job_id != job_id or crc32(body.encode()) != crc:
                text = f"{self._db.name}: the approval of job {job_id} is damaged"
                raise DamagedRecord(text, "approve its plan again: `tutti job approve`")
            return approval
        return None

    def _store(self, approval: JobApproval) -> None:
        body = approval.model_dump_json()
        self._db.write(_STORE, (approval.job_id, body, crc32(body.encode())))
