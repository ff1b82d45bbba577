"""A spec of scanspec 1.x that flies, as a scan that flies: its lines and its time at each point.

Of the kinds of specs those that are lines in nested axes can be flown: `Linspace`, `Product` and `Snake`, and `Zip` of
the innermost lines, with `Fly` and a duration around these. `Spiral`, and whatever else has no gap between its windows,
is a curve. All others with `Fly` are refused, so that none is ever stepped.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from orchestrator.model.errors import Refusal
from orchestrator.model.scans.spec_points import contains_fly, import_scanspec
from orchestrator.model.script import WrongValue
from orchestrator.model.steps.scan import Scan

_STEPPED = "leave out `Fly`, and it is stepped; or write the scan with `axes` and `fly`"
_FLOWN = "`Linspace`, `Product`, `Snake`, `Zip` of lines, and `Spiral` can be flown"
_UNBENT = frozenset({"Range", "Static", "Squash"})  # kinds that are no curve, and could be written as one


@dataclass(frozen=True, slots=True)
class _Level:
    """A level of a spec: lines or curves of axes that move together, by axis. flies, duration_s: what is around it."""

    lines: dict[str, dict[str, Any]]
    flies: bool
    duration_s: float | None

    @property
    def shape(self) -> tuple[int, bool]:
        """Its points, and whether it snakes."""
        line = next(iter(self.lines.values()))
        return len(line["values"]) if "values" in line else int(line["points"]), bool(line["snake"])

    @property
    def is_curved(self) -> bool:
        """Whether it is a curve."""
        return any("bounds" in line for line in self.lines.values())

    def list_curves(self) -> dict[str, dict[str, Any]]:
        """The same as curves."""
        return {name: line if "bounds" in line else _bend_line(line) for name, line in self.lines.items()}


@dataclass(frozen=True, slots=True)
class _Around:
    """What is around a part of a spec."""

    snake: bool = False
    flies: bool = False
    duration_s: float | None = None


def place_flown_spec(scan: Scan) -> Scan:
    """A scan whose spec has `Fly`, with axes instead of the spec; others as they are. Raises `Refusal`: codes
    `no-scanspec`, `bad-scanspec`."""
    if scan.scanspec is None:
        return scan
    if not contains_fly(scan.scanspec):
        if scan.fly is None:
            return scan
        raise Refusal("bad-scanspec", "the scan has `fly`, and its spec no `Fly`", "put `Fly(…)` around the spec")
    _, spec_type = import_scanspec()
    try:
        spec: dict[str, Any] = spec_type.deserialize(dict(scan.scanspec)).serialize()
    except Exception as error:  # whatever another project raises for a spec that it cannot read
        raise Refusal("bad-scanspec", f"scanspec cannot read the spec: {error}", "correct the spec") from None
    levels = _list_levels(spec, _Around())
    innermost = levels[-1]
    if not innermost.flies:
        text = "`Fly` is not around the innermost axis of the spec, and that is the one that can fly"
        raise Refusal("bad-scanspec", text, _STEPPED)
    duration_s = innermost.duration_s
    if duration_s is None:
        text = "the spec has `Fly` without a duration, so that its speed is not known"
        raise Refusal("bad-scanspec", text, "add one: `0.02 @ spec` in Python (`ConstantDuration`), or leave out `Fly`")
    if duration_s <= 0.0:
        text = f"the spec has `Fly` with a duration of {duration_s:g} s; it must be above 0"
        raise Refusal("bad-scanspec", text, "correct the duration")
    fields = {name: getattr(scan, name) for name in scan.model_fields_set - {"scanspec", "axes", "fly"}}
    fly: dict[str, Any] = {} if scan.fly is None else scan.fly.model_dump(mode="json", exclude_none=True)
    duration = f"{round(duration_s * 1e9)} ns"
    if {"axis", "speed"} & fly.keys() or fly.get("duration", duration) != duration:
        text = "`fly` beside a spec says how it flies otherwise: the spec states its axes, and the time at each point"
        raise Refusal("bad-scanspec", text, f"remove `axis` and `speed`, and write `duration: {duration}` or none")
    fly["duration"] = duration
    if len(innermost.lines) > 1:
        fly["axis"] = list(innermost.lines)
    try:
        return Scan(**fields, axes=_join_levels(levels), fly=fly)
    except WrongValue as error:
        raise Refusal("bad-scanspec", f"the spec cannot be flown: {error}", _STEPPED) from None


def _list_levels(node: Mapping[str, Any] | int | None, around: _Around) -> list[_Level]:
    """The levels of a spec, the outermost first. Raises `Refusal`."""
    if node is None or isinstance(node, int):
        text = "the spec has `Fly` with a duration alone" if node is None else f"the spec has `Fly`, {node} times"
        raise Refusal("bad-scanspec", f"{text}, which cannot be flown; {_FLOWN}", _STEPPED)
    kind = str(node["type"])
    if kind == "Fly":
        return _list_levels(node["spec"], replace(around, flies=True))
    if kind == "ConstantDuration":
        return _list_levels(node["spec"], replace(around, duration_s=float(node["constant_duration"])))
    if kind == "Snake":
        return _list_levels(node["spec"], replace(around, snake=True))
    if kind == "Product":
        return [level for part in ("outer", "inner") for level in _list_levels(node[part], around)]
    if kind == "Zip":
        return _zip_levels(*(_list_levels(node[part], around) for part in ("left", "right")))
    if kind == "Linspace":
        return [_Level({str(node["axis"]): _make_line(node, snake=around.snake)}, around.flies, around.duration_s)]
    return [_make_curve(node, around)]


def _make_curve(node: Mapping[str, Any], around: _Around) -> _Level:
    """A spec of another kind as a curve. Raises `Refusal` for one that has gaps between its windows, or several
    levels."""
    _, spec_type = import_scanspec()
    kind, dimensions, duration_s = str(node["type"]), list[Any](), around.duration_s
    try:
        spec: Any = spec_type.deserialize(dict(node))
        if kind not in _UNBENT:
            dimensions.extend(spec.calculate(bounds=True))
        duration_s = duration_s if spec.duration() is None else float(spec.duration())
    except Exception as error:  # whatever another project raises for a spec that it cannot calculate
        raise Refusal("bad-scanspec", f"scanspec cannot calculate {kind}: {error}", "correct the spec") from None
    if len(dimensions) != 1 or not _is_continuous(dimensions[0]):
        text = f"the spec has `Fly` with {kind}, which cannot be flown; {_FLOWN}"
        raise Refusal("bad-scanspec", text, _STEPPED)
    dimension: Any = dimensions[0]
    lines: dict[str, dict[str, Any]] = {}
    for axis in dimension.axes():
        bounds: list[float] = [*dimension.lower[axis].tolist(), float(dimension.upper[axis][-1])]
        lines[str(axis)] = {"values": dimension.midpoints[axis].tolist(), "bounds": bounds, "snake": around.snake}
    return _Level(lines, around.flies, duration_s)


def _is_continuous(dimension: Any) -> bool:
    """Whether the windows of a dimension follow each other without a gap, and two of them at least."""
    ends = [(dimension.upper[axis][:-1], dimension.lower[axis][1:]) for axis in dimension.axes()]
    return len(dimension) > 1 and all(bool((upper == lower).all()) for upper, lower in ends)


def _bend_line(line: Mapping[str, Any]) -> dict[str, Any]:
    """A line as a curve."""
    count, first = int(line["points"]), float(line["from"])
    spacing = (float(line["to"]) - first) / (count - 1)
    values = [first + spacing * number for number in range(count)]
    bounds = [first + spacing * (number - 0.5) for number in range(count + 1)]
    return {"values": values, "bounds": bounds, "snake": line["snake"]}


def _make_line(node: Mapping[str, Any], *, snake: bool) -> dict[str, Any]:
    start, stop, points = float(node["start"]), float(node["stop"]), int(node["num"])
    # Of one point the middle, as scanspec has it.
    ends = {"from": start, "to": stop, "points": points} if points > 1 else {"values": [start]}
    return {**ends, "snake": snake}


def _zip_levels(left: list[_Level], right: list[_Level]) -> list[_Level]:
    """The levels of one spec, its innermost together with the only one of another. Raises `Refusal`."""
    inner, added_level = left[-1], right[-1]
    if len(right) > 1:
        text = "the spec has `Fly` with Zip of several levels, which cannot be flown"
        raise Refusal("bad-scanspec", text, f"zip lines: `outer * line.zip(line)`; or {_STEPPED}")
    if inner.shape != added_level.shape:
        words = " and ".join(
            f"{', '.join(level.lines)} with {level.shape[0]} points" + ", in a Snake" * level.shape[1]
            for level in (inner, added_level)
        )
        text = f"the spec has `Fly` with Zip of {words}; axes on one line need as many points, and a Snake around all"
        raise Refusal("bad-scanspec", text, "write as many points for both, and `~` before the Zip")
    _require_single([*inner.lines, *added_level.lines])
    duration_s = added_level.duration_s if inner.duration_s is None else inner.duration_s
    has_curve = inner.is_curved or added_level.is_curved
    lines, added_lines = (level.list_curves() if has_curve else level.lines for level in (inner, added_level))
    return [*left[:-1], _Level({**lines, **added_lines}, inner.flies and added_level.flies, duration_s)]


def _join_levels(levels: list[_Level]) -> dict[str, dict[str, Any]]:
    """The axes of all levels. Raises `Refusal`."""
    for level in levels[:-1]:
        if len(level.lines) > 1:
            text = f"the spec has `Fly` with {', '.join(level.lines)} together outside of the axes that fly"
            raise Refusal("bad-scanspec", text, f"zip the innermost lines only; or {_STEPPED}")
    _require_single([name for level in levels for name in level.lines])
    return {name: line for level in levels for name, line in level.lines.items()}


def _require_single(names: list[str]) -> None:
    """Raise `Refusal` for an axis that is named twice."""
    repeated_names = [name for number, name in enumerate(names) if name in names[:number]]
    if repeated_names:
        raise Refusal("bad-scanspec", f"the spec has `Fly`, and axis {repeated_names[0]} twice", _STEPPED)
