"""What a reader of the stream needs: parts of the state, and controllers by their names."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import cast

from orchestrator.model.errors import Refusal
from orchestrator.model.text.name_patterns import check_pattern, select_names

PARTS = ("controllers", "virtual", "leases", "jobs", "members", "paths", "alarms", "events", "queue", "views")
"""The rest of the state is always sent: it is small, whatever the fleet."""
MAX_ITEMS = 2_000
MAX_DIGITS = 9
MAX_REMEMBERED = 400  # needs whose names are remembered
_CONTROLLERS = "controllers/"
_REMEDY = f"name parts of the state ({', '.join(PARTS)}), or controllers: `controllers/hall-1*`"


@dataclass(frozen=True, slots=True)
class StreamNeed:
    """parts: names of `PARTS`. patterns: of the controllers whose states, leases and stages are needed; None: all."""

    parts: frozenset[str]
    patterns: frozenset[str] | None = None


EVERYTHING = StreamNeed(frozenset(PARTS))
WITHOUT_CONTROLLERS = StreamNeed(EVERYTHING.parts - {"controllers", "leases", "members"})
"""What a reader gets of a fleet that is larger than it has asked for, until it says which controllers it needs."""


class ChosenNames:
    """The names that each need chooses, until they change."""

    def __init__(self) -> None:
        self._names: dict[StreamNeed, list[str]] = {}

    def choose(self, need: StreamNeed, names: Iterable[str]) -> list[str]:
        """Those of `names` that are needed, sorted."""
        chosen_names = self._names.get(need)
        if chosen_names is None:
            if len(self._names) >= MAX_REMEMBERED:
                self._names.clear()
            sorted_names = sorted(names)
            chosen_names = sorted_names if need.patterns is None else select_names(need.patterns, sorted_names)
            self._names[need] = chosen_names
        return chosen_names

    def clear(self) -> None:
        """The names have changed."""
        self._names.clear()


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


def read_query(texts: Iterable[str], most: str, controllers: int) -> StreamNeed:
    """What an address asks for.

    texts: the values of `need`, each with commas between its items; without any, everything. most: of how many
    controllers that is meant; "" for any number. controllers: the number of the fleet. Raises `Refusal`."""
    texts = list(texts)
    if not texts and not most:
        return EVERYTHING
    if not texts:
        if not most.isdecimal() or len(most) > MAX_DIGITS:
            raise Refusal("bad-request", f"most={most[:40]} is no number", "for example most=60")
        return WITHOUT_CONTROLLERS if controllers > int(most) else EVERYTHING
    return read_need([item for text in texts for item in text.split(",") if item])


def _read_pattern(item: str) -> str:
    try:
        return check_pattern(item.removeprefix(_CONTROLLERS))
    except ValueError as error:
        raise Refusal("bad-request", f"`need`: {error}", _REMEDY) from None
