"""Probes ahead: their speed, how long they take at most, and how far their axes go on behind the contact."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import hypot
from typing import NamedTuple

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import split_name
from orchestrator.model.state import PROBE_BY_HOST, ControllerInfo, ProbeAbility, StepCosts
from orchestrator.model.steps.probe import Probe
from orchestrator.model.steps.speed import MANUAL
from orchestrator.model.units import Unit, UnitError, parse_rate
from orchestrator.plan.speeds import TOLERANCE

LINE_BY_HOST = "let the coordinator stop them (`by: host`), which has a longer overtravel"


class ContactRange(NamedTuple):
    """Between which motor positions a contact is found, in the unit of the axis."""

    low: Fraction
    high: Fraction


@dataclass(frozen=True, slots=True)
class ProbeAbilities:
    """How a controller stops axes by its inputs, itself and by its host, several on a line, and by limit switches;
    None: it does not. make: its name. costs: what a stop takes. shows_inputs: also while a step moves its axes."""

    make: str
    costs: StepCosts
    controller: ProbeAbility | None
    host: ProbeAbility | None
    limit: ProbeAbility | None
    line: ProbeAbility | None
    shows_inputs: bool

    @classmethod
    def of(cls, info: ControllerInfo) -> "ProbeAbilities":
        """Those that a controller states."""
        abilities = (info.probe, info.host_probe, info.limit_probe, info.line_probe)
        return cls(info.make, info.costs, *abilities, info.shows_inputs)

    def require_ability(self, fleet: Fleet, step: Probe, name: str) -> ProbeAbility:
        """What stops an axis of a step. Raises `Refusal` that says what would."""
        member, _ = split_name(name)
        if step.limit is not None:
            if self.limit is None:
                text = f"{name}: the make {self.make} does not state how its limit switches stop an axis"
                raise Refusal("no-probe", text, "probe until an input changes", member)
            return self.limit
        if step.by == "host":
            if self.host is None:
                text = f"{name}: the make {self.make} cannot jog, and so cannot probe"
                raise Refusal("no-probe", text, "probe with an axis of another controller", member)
            return self.host
        ability = self.line if step.is_line else self.controller
        if ability is None or not any(ability.inputs.values()):
            ability_text = f"{' and '.join(step.axes)}: the make {self.make} cannot stop"
            if step.is_line:
                text = f"{ability_text} several axes on a line by an input"
                raise Refusal("no-probe", text, LINE_BY_HOST, member)
            raise Refusal("no-probe", f"{ability_text} an axis by an input", PROBE_BY_HOST, member)
        number = fleet.controllers[member].inputs[split_name(step.until)[1]].number
        way = ability.find_way(split_name(name)[1], number, step.level)
        if way is None:
            raise self._make_unfit(ability, step, name, number)
        return way

    def _make_unfit(self, ability: ProbeAbility, step: Probe, name: str, number: int) -> Refusal:
        """The refusal of an input that does not stop an axis, or not at that level. number: of the input."""
        member, axis = split_name(name)
        numbers = {*ability.inputs.get(axis, []), *(ability.slower.inputs.get(axis, []) if ability.slower else [])}
        if number not in numbers:
            fitting = " or ".join(f"input {fitting_number}" for fitting_number in sorted(numbers)) or "no input"
            text = f"{step.until} is input {number}, which does not stop {name}; {fitting} does"
            remedy = f"connect the signal there, or {LINE_BY_HOST if step.is_line else PROBE_BY_HOST}"
            return Refusal("probe-input", text, remedy, member)
        text = f"the make {self.make} stops an axis when an input becomes {' or '.join(ability.levels)} only"
        return Refusal("probe-input", text, PROBE_BY_HOST, member)


def make_other_start(name: str, position_here: float, begin: Fraction, axis: Axis) -> Refusal:
    """The refusal of a probe for an axis that stands elsewhere than where it begins, user positions."""
    text = f"axis {name} is at {position_here:g} {axis.unit}; the probe begins at {float(begin):g} {axis.unit}"
    return Refusal("other-start", text, f"move it there before: a step `do: move` to {float(begin):g}")


def find_most_speeds(step: Probe, axes: Mapping[str, Axis]) -> dict[str, float]:
    """The speeds that the axes of a probe have at most, in their units/s: of one alone its own. Raises `Refusal`."""
    limits = {name: axis.limits.velocity for name, axis in axes.items()}
    speed = step.speed
    if speed == MANUAL:
        return {name: axis.manual_speed * limits[name] for name, axis in axes.items()}
    if isinstance(speed, str):
        if len({axis.unit for axis in axes.values()}) > 1:
            text = f"speed {speed}: the axes have different units"
            raise Refusal("bad-unit", text, f"name the axis whose speed it is: {{{step.axes[0]}: {speed}}}")
        return {name: _find_stated(name, axis, speed, whole=not step.is_line) for name, axis in axes.items()}
    if not isinstance(speed, dict):
        return {name: speed * limit for name, limit in limits.items()}
    shares = {name: speed.get(name, 1.0) for name in axes}
    return {
        name: _find_stated(name, axes[name], share) if isinstance(share, str) else share * limits[name]
        for name, share in shares.items()
    }


def find_probe_speeds(step: Probe, axes: Mapping[str, Axis], ways: Mapping[str, float]) -> dict[str, float]:
    """The speeds of the axes of a probe, in their units/s: all of a line go their ways in one time. ways: how far each
    goes, in its unit. Raises `Refusal`."""
    most = find_most_speeds(step, axes)
    moving_axes = [name for name in axes if ways[name]]
    if not step.is_line or not moving_axes:
        return most
    if isinstance(step.speed, str) and step.speed != MANUAL:
        time_s = hypot(*ways.values()) / _parse_speed(moving_axes[0], step.speed, axes[moving_axes[0]].unit)
    else:
        time_s = max(abs(ways[name]) / most[name] for name in moving_axes)
    speeds = {name: abs(way) / time_s for name, way in ways.items()}
    for name, axis in axes.items():
        _require_limit(name, axis, speeds[name], step.speed)
    return {name: min(speeds[name], axis.limits.velocity) for name, axis in axes.items()}


def _find_stated(name: str, axis: Axis, speed: str, *, whole: bool = True) -> float:
    """A speed that is stated for an axis, or, not `whole`, for the line of which it is one: at most its limit."""
    value = _parse_speed(name, speed, axis.unit)
    if whole:
        _require_limit(name, axis, value, speed)
    return min(value, axis.limits.velocity)


def _require_limit(name: str, axis: Axis, value: float, speed: object) -> None:
    limit = axis.limits.velocity
    if value > limit * (1 + TOLERANCE):
        text = f"speed {speed}: {name} would move at {value:g} {axis.unit}/s; its limit is {limit:g}"
        raise Refusal("velocity-limit", text, "probe more slowly")


def _parse_speed(name: str, speed: str, unit: Unit) -> float:
    try:
        return parse_rate(speed, unit, 1)
    except UnitError as error:
        raise Refusal("bad-unit", f"speed of {name}: {error}", "correct the unit") from None


def find_overtravel(ability: ProbeAbility, axis: Axis, speed: float, ramp: float) -> float:
    """How far an axis goes behind the contact at most, in counts. speed, ramp: in its unit/s and unit/s²."""
    scale = float(axis.scale)
    return ability.find_overtravel(speed * scale, ramp * scale)


def find_longest_s(axis: Axis, distance: float, speed: float) -> float:
    """How long an axis takes at most that moves by `distance` and finds nothing, s."""
    return abs(distance) / speed + 2 * speed / axis.limits.acceleration if speed else 0.0
