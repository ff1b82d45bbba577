"""A spec of scanspec 1.x that flies, as a scan that flies: its lines and its time at each point.

Of the kinds of specs those that are lines in nested axes can be flown: `Linspace`, `Product` and `Snake`, with `Fly`
and a duration around the innermost one. All others with `Fly` are refused, so that none is ever stepped.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from orchestrator.model.errors import Refusal
from orchestrator.model.scans.spec_points import contains_fly, import_scanspec
from orchestrator.model.script import WrongValue
from orchestrator.model.steps.scan import Scan

_STEPPED = "leave out `Fly`, and it is stepped; or write the scan with `axes` and `fly`"
_FLOWN = "`Linspace`, `Product` and `Snake` can be flown"


@dataclass(slots=True)
class _Lines:
    """The axes of a spec, the outermost first, and what is around the innermost one."""

    axes: dict[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])
    flies: bool = False
    duration_s: float | None = None


def place_flown_spec(scan: Scan) -> Scan:
    """A scan whose spec has `Fly`, with axes instead of the spec; others as they are. Raises `Refusal`: codes
    `no-scanspec`, `bad-scanspec`."""
    if scan.scanspec is None or not contains_fly(scan.scanspec):
        return scan
    _, spec_type = import_scanspec()
    try:
        spec: dict[str, Any] = spec_type.deserialize(dict(scan.scanspec)).serialize()
    except Exception as error:  # whatever another project raises for a spec that it cannot read
        raise Refusal("bad-scanspec", f"scanspec cannot read the spec: {error}", "correct the spec") from None
    lines = _Lines()
    _take_spec(spec, lines, snake=False, flies=False, duration_s=None)
    if not lines.flies:
        text = "`Fly` is not around the innermost axis of the spec, and that is the one that can fly"
        raise Refusal("bad-scanspec", text, _STEPPED)
    if lines.duration_s is None:
        text = "the spec has `Fly` without a duration, so that its speed is not known"
        raise Refusal("bad-scanspec", text, "add one: `0.02 @ spec` in Python (`ConstantDuration`), or leave out `Fly`")
    if lines.duration_s <= 0.0:
        text = f"the spec has `Fly` with a duration of {lines.duration_s:g} s; it must be above 0"
        raise Refusal("bad-scanspec", text, "correct the duration")
    fields = {name: getattr(scan, name) for name in scan.model_fields_set - {"scanspec", "axes", "fly"}}
    try:
        return Scan(**fields, axes=lines.axes, fly={"duration": f"{round(lines.duration_s * 1e9)} ns"})
    except WrongValue as error:
        raise Refusal("bad-scanspec", f"the spec cannot be flown: {error}", _STEPPED) from None


def _take_spec(
    node: Mapping[str, Any] | int | None, lines: _Lines, *, snake: bool, flies: bool, duration_s: float | None
) -> None:
    """Add the axes of a spec. snake, flies, duration_s: what is around it. Raises `Refusal`."""
    if node is None or isinstance(node, int):
        text = "the spec has `Fly` with a duration alone" if node is None else f"the spec has `Fly`, {node} times"
        raise Refusal("bad-scanspec", f"{text}, which cannot be flown; {_FLOWN}", _STEPPED)
    kind = str(node["type"])
    if kind == "Fly":
        _take_spec(node["spec"], lines, snake=snake, flies=True, duration_s=duration_s)
    elif kind == "ConstantDuration":
        _take_spec(node["spec"], lines, snake=snake, flies=flies, duration_s=float(node["constant_duration"]))
    elif kind == "Snake":
        _take_spec(node["spec"], lines, snake=True, flies=flies, duration_s=duration_s)
    elif kind == "Product":
        for part in ("outer", "inner"):
            _take_spec(node[part], lines, snake=snake, flies=flies, duration_s=duration_s)
    elif kind == "Linspace":
        _take_line(node, lines, snake=snake)
        lines.flies, lines.duration_s = flies, duration_s  # of the innermost one in the end
    else:
        text = f"the spec has `Fly` with {kind}, which cannot be flown; {_FLOWN}"
        raise Refusal("bad-scanspec", text, _STEPPED)


def _take_line(node: Mapping[str, Any], lines: _Lines, *, snake: bool) -> None:
    name, start, stop, points = str(node["axis"]), float(node["start"]), float(node["stop"]), int(node["num"])
    if name in lines.axes:
        raise Refusal("bad-scanspec", f"the spec has `Fly`, and axis {name} twice", _STEPPED)
    # Of one point the middle, as scanspec has it.
    ends = {"from": start, "to": stop, "points": points} if points > 1 else {"values": [start]}
    lines.axes[name] = {**ends, "snake": snake}
