"""A fleet of many controllers in few lines: how many are in which mode, and the names of those that a person looks for.

What is at rest and sound is counted; all else is named, as far as it fits.
"""

from collections import Counter
from collections.abc import Mapping

from rich.console import Group, RenderableType
from rich.text import Text

from orchestrator.model.operation.troubles import TROUBLES, find_trouble
from orchestrator.model.state import ControllerState

MANY = 20  # controllers: more of them are summed up
MAX_NAMED = 8  # controllers of one kind
_NAMED = {
    "fault": "red",
    "offline": "red",
    "silent": "red",
    "limit": "red",
    "e-stop": "bold red",
    "under manual control": "yellow",
    "stopping": "yellow",
    "homing": "cyan",
    "jogging": "cyan",
    "committed": "yellow",
    "armed": "yellow",
    "moving": "cyan",
    "off": "yellow",
    "unreferenced": "yellow",
    "without a permit": "yellow",
}
"""What is named, in this order, with its style."""


def make_fleet_summary(
    states: Mapping[str, ControllerState],
    ages: Mapping[str, float] | None = None,
    permits: Mapping[str, str] | None = None,
) -> RenderableType:
    """Sum up a fleet. ages: by controller, the age in s of a state that is too old to be shown as live. permits: by
    axis, those that are missing."""
    ages = ages or {}
    without_permit = {axis.partition(".")[0] for axis in permits or {}}
    counts: Counter[str] = Counter()
    names_by_kind: dict[str, list[str]] = {kind: [] for kind in _NAMED}
    for name, state in sorted(states.items()):
        kind = "silent" if name in ages else _find_kind(state)
        counts[kind if kind in TROUBLES else state.mode] += 1
        if kind is None and name in without_permit:
            kind = "without a permit"
        if kind is not None:
            names_by_kind[kind].append(f"{name}{_explain(state) if kind in TROUBLES else ''}")
    count_list = ", ".join(f"{count:,} {kind}" for kind, count in counts.most_common())
    head = Text(f"{len(states):,} controllers: {count_list}")
    return Group(head, *(_make_line(kind, names) for kind, names in names_by_kind.items() if names))


def _find_kind(state: ControllerState) -> str | None:
    """What a controller is named for; None: it is at rest and sound."""
    trouble = find_trouble(state)
    if trouble is not None:
        return trouble
    if any(holder.startswith("manual-") for holder in state.leases.values()) and state.mode == "idle":
        return "under manual control"
    if state.mode != "idle":
        return state.mode
    if not all(axis.enabled for axis in state.axes.values()):
        return "off"
    return None if all(axis.referenced for axis in state.axes.values()) else "unreferenced"


def _explain(state: ControllerState) -> str:
    """The reason, in brackets: its first fault, or its e-stop."""
    if state.faults:
        return f" ({state.faults[0].text})"
    if state.estop is not None and state.estop.reason:
        return f" ({state.estop.reason})"
    return ""


def _make_line(kind: str, names: list[str]) -> Text:
    more = f" and {len(names) - MAX_NAMED:,} more" if len(names) > MAX_NAMED else ""
    return Text.assemble((f"{len(names):,} {kind}", _NAMED[kind]), f": {', '.join(names[:MAX_NAMED])}{more}")
