"""What a reader of the stream needs: parts of the state, and controllers by their names."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import cast

from orchestrator.model.errors import Refusal
from orchestrator.model.text.name_patterns import check_pattern

PARTS = ("controllers", "virtual", "leases", "jobs", "members", "paths", "alarms", "events", "queue", "views")
"""The rest of the state is always sent: it is small, whatever the fleet."""
MAX_ITEMS = 2_000
_CONTROLLERS = "controllers/"
_REMEDY = f"name parts of the state ({', '.join(PARTS)}), or controllers: `controllers/hall-1*`"


@dataclass(frozen=True, slots=True)
class StreamNeed:
    """parts: names of `PARTS`. patterns: of the controllers whose states, leases and stages are needed; None: all."""

    parts: frozenset[str]
    patterns: frozenset[str] | None = None


EVERYTHING = StreamNeed(frozenset(PARTS))


def read_need(items: object) -> StreamNeed:
    """What a list of texts asks for: `jobs`, `controllers`, `controllers/hall-1*`. Raises `Refusal`."""
    if not isinstance(items, list) or len(cast(list[object], items)) > MAX_ITEMS:
        raise Refusal("bad-request", f"`need` must be a list of at most {MAX_ITEMS} texts", _REMEDY)
    parts: set[str] = set()
    patterns: set[str] = set()
    for item in cast(list[object], items):
        if item in PARTS:
            parts.add(str(item))
        elif isinstance(item, str) and item.startswith(_CONTROLLERS):
            patterns.add(_read_pattern(item))
        else:
            raise Refusal("bad-request", f"`need`: there is no part {str(item)[:40]!r}", _REMEDY)
    if patterns and "controllers" not in parts:
        return StreamNeed(frozenset(parts | {"controllers"}), frozenset(patterns))
    return StreamNeed(frozenset(parts))


def read_query(texts: Iterable[str]) -> StreamNeed:
    """What the values of `need` in an address ask for, each with commas between its items; everything without any.
    Raises `Refusal`."""
    texts = list(texts)
    if not texts:
        return EVERYTHING
    return read_need([item for text in texts for item in text.split(",") if item])


def _read_pattern(item: str) -> str:
    try:
        return check_pattern(item.removeprefix(_CONTROLLERS))
    except ValueError as error:
        raise Refusal("bad-request", f"`need`: {error}", _REMEDY) from None
