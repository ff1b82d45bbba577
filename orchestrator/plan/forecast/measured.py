"""The forecast of targets that probes measure: the whole range of them is checked, and the axis is somewhere in it."""

from collections.abc import Mapping
from fractions import Fraction

from orchestrator.model.steps.base import Step
from orchestrator.model.steps.measured import MeasuredTarget
from orchestrator.model.steps.numbers import name_step
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.targets import check_target
from orchestrator.plan.probes import ContactRange


def take_measured(state: ForecastState, at: ForecastContext, step: Step, key: str) -> list[str]:
    """Check all measured targets of a step, and lose the positions of their axes, but for their ranges; return these
    axes. key: the field of the step that has them."""
    ranges = check_measured(state, at, step, key)
    for name in ranges:
        state.require_ready(at, name, (key, name))
    state.lose_positions(at, ranges)
    state.ranges |= {name: reach for name, reach in ranges.items() if reach is not None}
    return list(ranges)


def check_measured(
    state: ForecastState, at: ForecastContext, step: Step, key: str, what: str = ""
) -> Mapping[str, ContactRange | None]:
    """Check the range of all measured targets of a step; return it by axis, None where it is not known. what: is done
    with them, for notes, with the axis behind it; by default `gantry.x goes to`."""
    ranges: dict[str, ContactRange | None] = {}
    for name, target in step.measured_targets.items():
        axis = state.find_axis(at, name, (key, name), "target")
        if axis is not None:
            words = f"{what} {name} at" if what else f"{name} goes to"
            ranges[name] = _check_range(state, at, TargetField(key, name, axis), target, words)
    return ranges


def _check_range(
    state: ForecastState, at: ForecastContext, field: TargetField, target: MeasuredTarget, words: str
) -> ContactRange | None:
    state_before = state.find_state(at, field.name)
    # Where the user's zero was set at a position that is not known, motor positions are shown.
    is_user = state_before.offset_kind == "motor"
    offset = state_before.offset if is_user else Fraction(0)
    reach = _find_range(state, at, field, target)
    if reach is None:
        state.conditions[f"{target.describe()} is a position that {field.name} may have in {name_step(at.index)}"] = (
            None
        )
        return None
    for end in dict.fromkeys(reach):
        check_target(state, at, field, end, offset)
    unit = field.axis.unit if is_user else f"{field.axis.unit} (motor position)"
    low, high = (float(end + offset) for end in reach)
    state.notes[f"{words} {target.describe()}, between {low:g} and {high:g} {unit}"] = None
    return reach


def _find_range(
    state: ForecastState, at: ForecastContext, field: TargetField, target: MeasuredTarget
) -> ContactRange | None:
    """Between which motor positions a target is: by its own bounds, or by those of the contacts. None: not known."""
    plus = state.parse_amount(at, target.plus, field)
    if plus is None:
        return None
    state_before = state.find_state(at, field.name)
    if target.between is not None:
        if state_before.offset_kind != "motor":
            return None
        bounds = [state.parse_amount(at, bound, field) for bound in target.between]
        ends = sorted(bound - state_before.offset for bound in bounds if bound is not None)
        return ContactRange(ends[0], ends[-1]) if ends else None
    ranges = [state.contacts.get(name) for name in target.of]
    known_ranges = [contact for contact in ranges if contact is not None]
    if len(known_ranges) < len(ranges):
        return None
    count = len(known_ranges)
    low = sum((contact.low for contact in known_ranges), Fraction(0)) / count + plus
    return ContactRange(low, sum((contact.high for contact in known_ranges), Fraction(0)) / count + plus)
