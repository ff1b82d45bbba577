"""States of job orders and results of methods, as OPC 10031-4 v2 numbers them. It knows no protocol library.

Source: the nodeset (StateNumber of each state) and the specification, 6.2.1, 6.2.3 to 6.2.5 and B.2 (Table 95).
"""

from collections.abc import Iterable
from dataclasses import dataclass

from tutti import FINISHED_STATES, Refusal, TuttiError

NO_ERROR = 1 << 0
UNKNOWN_ORDER = 1 << 1
INVALID_STATUS = 1 << 3
NOT_ACCEPTED = 1 << 4
INVALID_REQUEST = 1 << 32
"""The bits of a ReturnStatus."""

_CODES = {
    UNKNOWN_ORDER: ("unknown-order", "unknown-job"),
    INVALID_STATUS: ("order-state", "not-queued", "not-running", "not-paused", "ended"),
    INVALID_REQUEST: ("bad-order", "bad-request"),
}
_STATUS_OF_CODE = {code: status for status, codes in _CODES.items() for code in codes}


@dataclass(frozen=True, slots=True)
class OrderState:
    """A state of a job order: its name and number, and those of its substate, if it has one."""

    name: str
    number: int
    substate: str = ""
    substate_number: int = 0

    @property
    def has_begun(self) -> bool:
        """Whether the job has begun, or ended."""
        return self.number >= RUNNING.number

    @property
    def is_ended(self) -> bool:
        """Whether the job order changes no more."""
        return self.number >= ENDED.number


NEW = OrderState("", 0)
HELD = OrderState("NotAllowedToStart", 1, "Waiting", 1)
AWAITS_START = OrderState("NotAllowedToStart", 1, "Ready", 2)
WAITING = OrderState("AllowedToStart", 2, "Waiting", 1)
READY = OrderState("AllowedToStart", 2, "Ready", 2)
RUNNING = OrderState("Running", 3)
INTERRUPTED = OrderState("Interrupted", 4, "Suspended", 2)
ENDED = OrderState("Ended", 5, "Completed", 1)
ABORTED = OrderState("Aborted", 6)


def find_state(state: str, reason: str = "", *, held: bool = False, ready: bool = False) -> OrderState:
    """The state of the order whose job is in `state`. reason: what a queued job waits for. ready: what it had to wait
    for is gone, and its start has to be asked for."""
    if state == "queued":
        if ready:
            return AWAITS_START
        if held:
            return HELD
        return READY if reason in ("", "submitted") else WAITING
    by_state = {"paused": INTERRUPTED, "done": ENDED}
    return by_state.get(state, ABORTED if state in FINISHED_STATES else RUNNING)


def find_status(error: TuttiError) -> int:
    """The ReturnStatus for what was not done."""
    if isinstance(error, Refusal):
        return _STATUS_OF_CODE.get(error.code, NOT_ACCEPTED)
    return INVALID_REQUEST  # a template with wrong values


def matches(state: OrderState, state_number: int, substates: Iterable[int]) -> bool:
    """Whether an order in `state` is meant by the number of a state and the numbers of substates."""
    return state.number == state_number and all(
        substate_number == state.substate_number for substate_number in substates
    )
