"""Resolve the names of positions in the targets of steps to plain quantities."""

from collections.abc import Iterable, Mapping, Sequence

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.fleet_names import list_names, suggest_name
from orchestrator.model.names import ALL_AXES, is_position_name
from orchestrator.model.positions.entries import PositionEntry
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.order import StepOrder
from orchestrator.model.steps.tree import iterate_steps
from orchestrator.model.units import Quantity, UnitError, format_quantity, parse_quantity

REMEDY = "see `tutti position ls`"
SAVE_REMEDY = "save it again, or remove it: `tutti position save`, `tutti position rm`"


class PositionResolver:
    """Resolves names by `entries`. used: the values that were taken so far, by position and axis, as text."""

    def __init__(self, fleet: Fleet, entries: Iterable[PositionEntry], *, keep_unknown: bool = False) -> None:
        """keep_unknown: names that no entry has stay as they are, instead of a refusal."""
        self._fleet = fleet
        self._entries = {entry.name: entry for entry in entries}
        self._keep_unknown = keep_unknown
        self.used: dict[str, dict[str, str]] = {}

    def resolve_steps(self, steps: Iterable[Step]) -> list[Step]:
        """Steps whose targets are all quantities. Raises `Refusal` for a name that has none."""
        return [self.resolve_step(step) for step in steps]

    def resolve_step(self, step: Step) -> Step:
        """The step with quantities for names, also inside repeats and scans, or itself. Raises `Refusal`."""
        return step.resolve_targets(self) if names_positions(step) else step

    def resolve_remaining(self, steps: Sequence[Step], repeat: int = 1, first: int = 0) -> StepOrder:
        """The order of `steps`, run `repeat` times, with quantities for the names in what is left from step number
        `first` on: positions that only steps before it name are not needed. Raises `Refusal`."""
        numbers = {step.number for step in StepOrder(steps, repeat).list_remaining(first)}
        resolved_steps = [self.resolve_step(step) if number in numbers else step for number, step in enumerate(steps)]
        return StepOrder(resolved_steps, repeat)

    def find_target(self, axis: str, target: Quantity) -> Quantity:
        """The quantity of one target of `axis`: itself, or the value of the position that it names.

        Raises `Refusal`."""
        if not is_position_name(target) or self._is_kept(target):
            return target
        entry = self._find_entry(str(target))
        if axis not in entry.axes:
            text = f"position {entry.name} has no value for {axis}; it has: {', '.join(entry.axes)}"
            raise Refusal("not-in-position", text, f"name another position, or give {axis} a value")
        return self._take_value(entry, axis)

    def find_whole(self, name: str) -> dict[str, Quantity]:
        """The values of all axes of a position, by axis; `{"*": name}` for an unknown name that stays. Raises
        `Refusal`."""
        if self._is_kept(name):
            return {ALL_AXES: name}
        entry = self._find_entry(name)
        return {axis: self._take_value(entry, axis) for axis in entry.axes}

    def _is_kept(self, target: Quantity) -> bool:
        return self._keep_unknown and target not in self._entries

    def _find_entry(self, name: str) -> PositionEntry:
        entry = self._entries.get(name)
        if entry is None:
            raise self.make_unknown(name)
        if not entry.axes:
            raise Refusal("bad-position", f"position {name}: {', '.join(entry.problems)}", SAVE_REMEDY)
        return entry

    def make_unknown(self, name: str) -> Refusal:
        """The refusal of a name that no position has, with the near ones."""
        known_entries = list(self._entries)
        name_list = list_names(known_entries, "position") if known_entries else "it has no positions"
        text = f"the fleet has no position {name[:80]}; {suggest_name(name, known_entries)}{name_list}"
        return Refusal("unknown-name", text, REMEDY)

    def _take_value(self, entry: PositionEntry, axis: str) -> Quantity:
        value = entry.axes[axis]
        if axis in self.used.get(entry.name, {}):
            return value
        problem = explain_value(self._fleet, axis, value)
        if problem is not None:
            raise Refusal("bad-position", f"position {entry.name}: {problem}", SAVE_REMEDY)
        self.used.setdefault(entry.name, {})[axis] = format_quantity(value, self._fleet.unit_of(axis))
        return value


def names_positions(step: Step) -> bool:
    """Whether a target of the step, or of one inside it, is the name of a position."""
    return any(is_position_name(target) for part in iterate_steps([step]) for _, target in part.iterate_targets())


def explain_value(fleet: Fleet, axis: str, value: Quantity) -> str | None:
    """Why `value` is no position of `axis` in this fleet; None if it is. Limits are checked with the job."""
    unknown = fleet.names.explain_unknown(axis, "target")
    if unknown is not None:
        return unknown
    try:
        parse_quantity(value, fleet.unit_of(axis))
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
