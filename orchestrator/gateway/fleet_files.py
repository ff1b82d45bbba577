"""Fleet files that arrive as text: their mistakes, and what differs from the fleet as it runs."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

from orchestrator.gateway.replies import describe_problems
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, read_document
from orchestrator.runtime.checked import check_loaded_fleet

# The running fleet has the links of its simulated controllers, and does not show the command for alarms.
_LEFT_OUT = frozenset({"simulate", "notify"})
MAX_CHANGES = 500


def compare_fleet(text: str, running: Fleet) -> dict[str, Any]:
    """Problems of a fleet file, its changes against the running one, and its JSON form for `reload`."""
    try:
        fleet = check_loaded_fleet(read_document(text, "fleet file"), tolerant=True)
    except FileError as error:
        return {"problems": describe_problems(error.problems), "changes": [], "configuration": None}
    changes = list(_find_changes(running.to_plain(), fleet.to_plain(), ()))
    return {"problems": [], "changes": changes[:MAX_CHANGES], "configuration": fleet.to_plain()}


def _find_changes(before: object, after: object, place: Sequence[str]) -> Iterator[dict[str, Any]]:
    if place and place[-1] in _LEFT_OUT:
        return
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        old, new = cast(Mapping[str, object], before), cast(Mapping[str, object], after)
        for key in dict.fromkeys([*old, *new]):
            yield from _find_changes(old.get(key), new.get(key), (*place, key))
    elif before != after:
        yield {"path": ".".join(place), "from": before, "to": after}
