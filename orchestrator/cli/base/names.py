"""Names that the user gives, against those of the fleet: unknown ones are answered with what is near."""

from collections.abc import Iterable
from difflib import get_close_matches
from typing import TYPE_CHECKING

from orchestrator.model.errors import Refusal

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.jobs.service import FleetNames
    from orchestrator.model.state import ControllerState

MAX_SHOWN = 12
NEAR = 0.7  # similarity from which a name is suggested


def unknown_name(kind: str, name: str, known: Iterable[str], remedy: str = "see `tutti status`") -> Refusal:
    """The refusal for a name that the fleet does not have, with the near ones, or with those that there are."""
    from orchestrator.model.numbers import name_odd_sign

    known = list(known)
    if (odd_sign := name_odd_sign(name)) != "":
        return Refusal("unknown-name", f"the fleet has no {kind} {name!r}; {odd_sign}", remedy)
    matches = get_close_matches(name, known, n=3, cutoff=NEAR)
    if matches:
        hint = f"did you mean {' or '.join(matches)}?"
    elif known:
        hint = f"it has: {', '.join(known[:MAX_SHOWN])}{' …' if len(known) > MAX_SHOWN else ''}"
    else:
        hint = f"it has no {kind} at all"
    return Refusal("unknown-name", f"the fleet has no {kind} {name}; {hint}", remedy)


def require_axes(names: "FleetNames", wanted: Iterable[str]) -> list[str]:
    """The axes that axes, groups and controllers stand for, each once. Raises `Refusal`."""
    axis_names: list[str] = []
    for name in wanted:
        axes = names.expand_name(name)
        if not axes:
            known_names = [*names.axes, *names.groups, *names.controllers, *names.virtual_groups]
            raise unknown_name("axis, group or controller", name, known_names)
        axis_names += axes
    return list(dict.fromkeys(axis_names))


async def explain_absence(tutti: "Tutti", refusal: Refusal) -> Refusal:
    """The reason why nothing answered, where more can be said: a controller that the fleet does not have, or a fleet
    that is not on the bus."""
    if refusal.code not in ("absent", "no-coordinator"):
        return refusal
    try:
        names = await tutti.list_names()
    except Refusal as error:
        return error
    if refusal.controller is not None and refusal.controller not in names.controllers:
        return unknown_name("controller", refusal.controller, names.controllers)
    return refusal


async def require_states(tutti: "Tutti") -> "dict[str, ControllerState]":
    """The states of all controllers. Raises `Refusal`, code `no-fleet`, if none answers."""
    states = await tutti.status()
    if not states:
        raise await tutti.find_absence()
    return states
