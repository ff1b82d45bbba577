"""Resolve the names of positions in the targets of steps to plain quantities."""

from collections.abc import Iterable, Mapping

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.fleet_names import list_names, suggest_name
from orchestrator.model.job import Move, Step
from orchestrator.model.names import ALL_AXES, is_position_name
from orchestrator.model.positions.entries import PositionEntry
from orchestrator.model.units import Quantity, UnitError, format_quantity, parse_quantity

REMEDY = "see `tutti position ls`"
SAVE_REMEDY = "save it again, or remove it: `tutti position save`, `tutti position rm`"


class PositionResolver:
    """Resolves names by `entries`. used: the values that were taken so far, by position and axis, as text."""

    def __init__(self, fleet: Fleet, entries: Iterable[PositionEntry]) -> None:
        self._fleet = fleet
        self._entries = {each.name: each for each in entries}
        self.used: dict[str, dict[str, str]] = {}

    def resolve_steps(self, steps: Iterable[Step]) -> list[Step]:
        """Steps whose targets are all quantities. Raises `Refusal` for a name that has none."""
        return [self.resolve_step(step) for step in steps]

    def resolve_step(self, step: Step) -> Step:
        """The step with quantities for names; itself if it has no names. A kind of step with other targets is resolved
        here, value by value with `find_target`."""
        if isinstance(step, Move) and names_positions(step):
            return step.model_copy(update={"to": self._resolve_move(step)})
        return step

    def resolve_known(self, step: Step) -> Step:
        """The step with quantities for the names that are known here; the others stay. Raises `Refusal` for a known one
        that does not fit."""
        if not isinstance(step, Move) or not names_positions(step):
            return self.resolve_step(step)
        unknown = {axis: name for axis, name in step.to.items() if is_position_name(name) and name not in self._entries}
        known = {axis: target for axis, target in step.to.items() if axis not in unknown}
        targets = self._resolve_move(step.model_copy(update={"to": known}))
        return step.model_copy(update={"to": {**targets, **unknown}})

    def find_target(self, axis: str, target: Quantity) -> Quantity:
        """The quantity of one target of `axis`: itself, or the value of the position that it names.

        Raises `Refusal`."""
        if not is_position_name(target):
            return target
        entry = self._find_entry(str(target))
        if axis not in entry.axes:
            text = f"position {entry.name} has no value for {axis}; it has: {', '.join(entry.axes)}"
            raise Refusal("not-in-position", text, f"name another position, or give {axis} a value")
        return self._take_value(entry, axis)

    def find_axes(self, name: str) -> dict[str, Quantity]:
        """The values of all axes of a position. Raises `Refusal`."""
        entry = self._find_entry(name)
        return {axis: self._take_value(entry, axis) for axis in entry.axes}

    def _resolve_move(self, step: Move) -> dict[str, Quantity]:
        whole = step.to.get(ALL_AXES)
        targets: dict[str, Quantity] = {} if whole is None else self.find_axes(str(whole))
        for axis, target in step.to.items():
            if axis != ALL_AXES:
                targets[axis] = self.find_target(axis, target)
        twice = sorted(targets.keys() & step.by.keys())
        if twice:
            text = f"{', '.join(twice)} is in `by` and in position {whole}; an axis has one target"
            raise Refusal("bad-step", text, "name the axes of the position that are to move: `to: {axis: position}`")
        return targets

    def _find_entry(self, name: str) -> PositionEntry:
        entry = self._entries.get(name)
        if entry is None:
            raise self.make_unknown(name)
        if not entry.axes:
            raise Refusal("bad-position", f"position {name}: {', '.join(entry.problems)}", SAVE_REMEDY)
        return entry

    def make_unknown(self, name: str) -> Refusal:
        """The refusal of a name that no position has, with the near ones."""
        known = list(self._entries)
        there = list_names(known, "position") if known else "it has no positions"
        text = f"the fleet has no position {name[:80]}; {suggest_name(name, known)}{there}"
        return Refusal("unknown-name", text, REMEDY)

    def _take_value(self, entry: PositionEntry, axis: str) -> Quantity:
        value = entry.axes[axis]
        problem = explain_value(self._fleet, axis, value)
        if problem is not None:
            raise Refusal("bad-position", f"position {entry.name}: {problem}", SAVE_REMEDY)
        self.used.setdefault(entry.name, {})[axis] = format_quantity(value, self._fleet.axis(axis).unit)
        return value


def names_positions(step: Step) -> bool:
    """Whether a target of the step is the name of a position."""
    return isinstance(step, Move) and any(is_position_name(target) for target in step.to.values())


def explain_value(fleet: Fleet, axis: str, value: Quantity) -> str | None:
    """Why `value` is no position of `axis` in this fleet; None if it is. Limits are checked with the job."""
    if axis not in fleet.names.axes:
        return fleet.names.explain_unknown(axis, "axis")
    try:
        parse_quantity(value, fleet.axis(axis).unit)
    except UnitError as error:
        return f"{axis} is {value}: {error}"
    return None


def list_file_positions(fleet: Fleet, covered: Mapping[str, object] = {}) -> list[PositionEntry]:
    """The positions of the fleet file. covered: names that are left out."""
    return [
        PositionEntry(name=name, axes=position.axes, description=position.description, source="file")
        for name, position in fleet.positions.items()
        if name not in covered
    ]
