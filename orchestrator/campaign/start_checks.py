"""Starts that nothing allows: without a decision or twice for one, and of a step whose wait has ended."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress

from orchestrator.campaign.jobs import JobOrder
from orchestrator.campaign.recording.recorder import RecordedRequest
from orchestrator.campaign.records import CampaignPhase
from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal

_ENDS_WAITS = ("permit-lost", "stop", "estop")  # faults of the whole fleet that no step may outlast
_SEEN_NS = NS_PER_S  # by then the fault has ended the wait: inputs are polled three times a second


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


def find_outlasted(requests: Sequence[RecordedRequest], phase: CampaignPhase) -> list[str]:
    """Steps that waited armed at the fault, and were released all the same, in words. requests: all of the phase."""
    fault_ns = phase.fault_ns
    if phase.fault.name not in _ENDS_WAITS or fault_ns is None:
        return []
    waiting_jobs = {job_id for job_id, order in phase.jobs.items() if _waits_armed(order)}
    asked_requests = [request for request in requests if request.verb != "lease" and request.job_id in waiting_jobs]
    asked_before = [request for request in asked_requests if request.sent_ns < fault_ns]
    armed_steps = _list_steps(asked_before, "arm") - _list_steps(asked_before, "commit")
    return [
        f"{request.member} was released for {request.step_id}, whose wait {phase.fault.name} has ended"
        for request in asked_requests
        if request.verb == "go" and request.step_id in armed_steps and request.sent_ns > fault_ns + _SEEN_NS
    ]


def _list_steps(requests: Iterable[RecordedRequest], verb: str) -> set[tuple[str, int]]:
    """The steps for which a member has accepted a request of this verb."""
    return {request.step_id for request in requests if request.verb == verb and request.accepted}


def _waits_armed(order: JobOrder) -> bool:
    return any(step.armed_terms is not None for step in order.job.steps)
