"""Steps that start at once: each after its decision, and once for it."""

from collections.abc import Callable
from contextlib import suppress

from orchestrator.campaign.recorder import RecordedRequest
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal


class AtOnceChecker:
    """Checks invariant 1 of these steps. add_violation: called with the invariant and a text."""

    def __init__(self, journal: SqliteJournal, add_violation: Callable[[str, str], None]) -> None:
        self._journal = journal
        self._add_violation = add_violation
        self._requests: dict[tuple[str, int, int], str] = {}
        """By job, step and decision: the request that has started it."""

    def check_request(self, request: RecordedRequest) -> None:
        """Check a request when it is sent, and when it is answered; others are no such start."""
        if request.verb != "start-at-once":
            return
        decision = request.fields["step"], request.fields["decided_fleet_ns"]
        if request.answered_ns is None:
            with suppress(JournalError):
                if decision not in self._journal.list_decisions(request.job_id):
                    text = f"{request.member} was asked to start {request.step_id} without a decision"
                    self._add_violation("1", text)
        elif request.accepted:
            request_id = self._requests.setdefault((request.job_id, *decision), request.fields["request_id"])
            if request_id != request.fields["request_id"]:
                self._add_violation("1", f"{request.member} has started {request.step_id} twice for one decision")
