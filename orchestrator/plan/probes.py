"""Probes ahead: their speed, how long they take at most, and how far their axis goes on behind the contact."""

from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import split_name
from orchestrator.model.state import PROBE_BY_HOST, ControllerInfo, ProbeAbility
from orchestrator.model.steps.probe import Probe
from orchestrator.model.steps.speed import MANUAL
from orchestrator.model.units import UnitError, parse_rate
from orchestrator.plan.speeds import TOLERANCE


class ContactRange(NamedTuple):
    """Between which motor positions a contact is found, in the unit of the axis."""

    low: Fraction
    high: Fraction


@dataclass(frozen=True, slots=True)
class ProbeAbilities:
    """How a controller stops axes by its inputs, itself and by its host, and by limit switches; None: it does not.
    make: its name."""

    make: str
    controller: ProbeAbility | None
    host: ProbeAbility | None
    limit: ProbeAbility | None

    @classmethod
    def of(cls, info: ControllerInfo) -> "ProbeAbilities":
        """Those that a controller states."""
        return cls(info.make, info.probe, info.host_probe, info.limit_probe)

    def require_ability(self, fleet: Fleet, step: Probe) -> ProbeAbility:
        """What stops the axis of a step. Raises `Refusal` that says what would."""
        member, axis = split_name(step.axis)
        if step.limit is not None:
            if self.limit is None:
                text = f"{step.axis}: the make {self.make} does not state how its limit switches stop an axis"
                raise Refusal("no-probe", text, "probe until an input changes", member)
            return self.limit
        if step.by == "host":
            if self.host is None:
                text = f"{step.axis}: the make {self.make} cannot jog, and so cannot probe"
                raise Refusal("no-probe", text, "probe with an axis of another controller", member)
            return self.host
        ability = self.controller
        if ability is None or not any(ability.inputs.values()):
            text = f"{step.axis}: the make {self.make} cannot stop an axis by an input"
            raise Refusal("no-probe", text, PROBE_BY_HOST, member)
        point, numbers = fleet.controllers[member].inputs[split_name(step.until)[1]], ability.inputs.get(axis, [])
        way = ability.find_way(axis, point.number, step.level)
        if way is not None:
            return way
        if ability.slower is not None:
            numbers = sorted({*numbers, *ability.slower.inputs.get(axis, [])})
        if point.number not in numbers:
            fitting = " or ".join(f"input {number}" for number in numbers) or "no input"
            text = f"{step.until} is input {point.number}, which does not stop {step.axis}; {fitting} does"
            raise Refusal("probe-input", text, f"connect the signal there, or {PROBE_BY_HOST}", member)
        text = f"the make {self.make} stops an axis when an input becomes {' or '.join(ability.levels)} only"
        raise Refusal("probe-input", text, PROBE_BY_HOST, member)


def make_other_start(name: str, position_here: float, begin: Fraction, axis: Axis) -> Refusal:
    """The refusal of a probe for an axis that stands elsewhere than where it begins, user positions."""
    text = f"axis {name} is at {position_here:g} {axis.unit}; the probe begins at {float(begin):g} {axis.unit}"
    return Refusal("other-start", text, f"move it there before: a step `do: move` to {float(begin):g}")


def find_probe_speed(step: Probe, axis: Axis) -> float:
    """The speed of a probe in the axis's unit/s. Raises `Refusal`."""
    limit = axis.limits.velocity
    if step.speed == MANUAL:
        return axis.manual_speed * limit
    if not isinstance(step.speed, str):
        return step.speed * limit
    try:
        speed = parse_rate(step.speed, axis.unit, 1)
    except UnitError as error:
        raise Refusal("bad-unit", f"speed of {step.axis}: {error}", "correct the unit") from None
    if speed > limit * (1 + TOLERANCE):
        text = f"speed {step.speed}: {step.axis} would move at {speed:g} {axis.unit}/s; its limit is {limit:g}"
        raise Refusal("velocity-limit", text, "probe more slowly")
    return min(speed, limit)


def find_overtravel(ability: ProbeAbility, axis: Axis, speed: float) -> float:
    """How far an axis goes behind the contact at most, in counts. speed: in its unit/s."""
    scale = float(axis.scale)
    return ability.find_overtravel(speed * scale, axis.limits.acceleration * scale)


def find_longest_s(axis: Axis, distance: float, speed: float) -> float:
    """How long a probe takes at most that moves by `distance` and finds nothing, s."""
    return abs(distance) / speed + 2 * speed / axis.limits.acceleration
