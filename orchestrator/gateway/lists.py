"""Long lists in parts: a cursor names the last entry of a part, so that what comes and goes meanwhile moves nothing."""

from base64 import urlsafe_b64decode, urlsafe_b64encode
from typing import Any

from orchestrator.gateway.stream.fleet_state import FleetState
from orchestrator.model.errors import Refusal
from orchestrator.model.text.name_patterns import check_pattern, select_names

MAX_LIMIT = 1000  # controllers of one part
_REMEDY = "take `next` of the answer before, or leave `cursor` out to begin again"


def make_cursor(path: str, last: str) -> str:
    """The cursor behind the entry `last` of a list."""
    return urlsafe_b64encode(f"{path} {last}".encode()).decode().rstrip("=")


def read_cursor(path: str, text: str) -> str:
    """The entry behind which the list goes on; "" for no cursor. Raises `Refusal`."""
    if not text:
        return ""
    try:
        head, _, last = urlsafe_b64decode(text + "=" * (-len(text) % 4)).decode().partition(" ")
    except ValueError:
        head, last = "", ""
    if head != path or not last or make_cursor(path, last) != text:
        raise Refusal("bad-request", f"cursor={text[:40]} is none of {path}", _REMEDY)
    return last


def list_controllers(state: FleetState, pattern: str, mode: str, limit: int, after: str) -> dict[str, Any]:
    """A part of the controllers, by name: those that fit `pattern` and are in `mode`; "" fits all. after: the
    name behind which it begins. Raises `Refusal`."""
    if not 1 <= limit <= MAX_LIMIT:
        raise Refusal("bad-request", f"limit={limit} is not within 1 to {MAX_LIMIT}", "for example limit=100")
    try:
        names = select_names([check_pattern(pattern)] if pattern else ["*"], sorted(state.controllers))
    except ValueError as error:
        raise Refusal("bad-request", f"name: {error}", "leave it out for all") from None
    entries = [(name, plain) for name, plain in state.list_controllers(names).items() if mode in ("", plain["mode"])]
    entries_behind = [(name, plain) for name, plain in entries if name > after]
    answer: dict[str, Any] = {"total": len(entries), "controllers": dict(entries_behind[:limit])}
    if len(entries_behind) > limit:
        answer["next"] = make_cursor("/v1/controllers", entries_behind[limit - 1][0])
    return answer
