"""Where the axes of a job are, step by step, and what is wrong with their targets."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal

from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.forecast import AxisForecast, StepProblem
from orchestrator.model.names import controller_of
from orchestrator.model.units import UnitError, parse_quantity
from orchestrator.plan.forecast_passes import TargetCheck
from orchestrator.plan.step import AxisMove, StepPlan
from orchestrator.plan.targets import choose_turn, explain_beyond_limits, explain_beyond_range, make_axis_move

Order = Literal[2, 3]


@dataclass(slots=True)
class MoveWays:
    """The ways of the axes of a motion, in counts. farthest: bounds of them, where the beginning is not known; bounded:
    whether there is a bound."""

    nearest: list[AxisMove] = field(default_factory=list[AxisMove])
    farthest: list[AxisMove] = field(default_factory=list[AxisMove])
    exact: dict[str, tuple[Fraction, int]] = field(default_factory=dict[str, tuple[Fraction, int]])
    bounded: bool = True
    plan: StepPlan | None = None

    def add_known(self, move: AxisMove) -> None:
        self.nearest.append(move)
        self.farthest.append(move)

    def add_unknown(self, longest: AxisMove | None) -> None:
        if longest is None:
            self.bounded = False
        else:
            self.farthest.append(longest)


class AxisForecaster:
    """Follows the positions of axes; `problems` and `conditions` grow, `axes` is the present state."""

    def __init__(
        self, fleet: Fleet, axes: Mapping[str, AxisForecast] | None = None, orders: Mapping[str, Order] | None = None
    ) -> None:
        """axes: their states now; others are unknown. orders: of the profiles that each controller executes."""
        self._fleet = fleet
        self._orders = orders or {}
        self.axes: dict[str, AxisForecast] = dict(axes or {})
        self.problems: list[StepProblem] = []
        self.conditions: dict[str, None] = {}
        self._index = 0
        self._place: tuple[str | int, ...] = ()
        self._checks: list[TargetCheck] = []
        """The targets that were compared with limits."""
        self._when = ""
        """The pass of a repeat, or the point of a scan, in words."""

    # Targets

    def _take_target(self, ways: MoveWays, place: tuple[str, str], axis: Axis, amount: Fraction) -> None:
        """Move one axis, and add its way."""
        name = place[1]
        before = self._state(name)
        after, distance_known = self._find_target(place, axis, amount)
        self.axes[name] = after
        order = self._order_of(name, axis)
        if distance_known:
            start, target = axis.to_counts(before.motor), axis.to_counts(after.motor)
            ways.add_known(make_axis_move(name, axis, start, target, order))
            if before.known and after.known:
                ways.exact[name] = (after.motor, target)
        else:
            ways.add_unknown(_longest_move(name, axis, after, order))

    def _order_of(self, name: str, axis: Axis) -> Order:
        return self._orders.get(controller_of(name), 2 if axis.limits.jerk is None else 3)

    def _find_target(self, place: tuple[str, str], axis: Axis, amount: Fraction) -> tuple[AxisForecast, bool]:
        """The state after a move, and whether the distance is known. place: `to` or `by`, and the axis."""
        name, relative = place[1], place[0] == "by"
        state = self._state(name)
        if relative:
            target = state.motor + amount
        elif state.offset_kind == "unknown":
            self.conditions[f"the target of {name} in step {self._index} depends on its user offset"] = None
            return state.model_copy(update=self._unknown_position()), False
        elif state.offset_kind == "motor" and not state.known:
            self._note_room(name, state)
            target = choose_turn(axis, amount - state.offset, amount - state.offset, state.offset)
            self._note_check(place, target, state.offset, known=True)
            self._check_target(place, axis, target, state.offset)
            self.conditions["user offsets (`set-position`) are 0 where no step sets them"] = None
            return state.model_copy(update={"motor": target, "known": True}), False
        else:
            target = choose_turn(axis, state.motor, amount - state.offset, state.offset)
        update: dict[str, object] = {"motor": target}
        self._note_check(place, target, state.offset, known=state.known)
        if state.known:
            if not self._check_target(place, axis, target, state.offset) and relative:
                update |= self._unknown_position()  # further moves by a distance would repeat the same mistake
        else:
            update |= {"lowest": min(state.lowest, target), "highest": max(state.highest, target)}
            after = state.model_copy(update=update)
            if not self._check_room(place, axis, after):
                update |= self._unknown_position()
        return state.model_copy(update=update), True

    def _unknown_position(self) -> dict[str, object]:
        return {
            "motor": Fraction(0),
            "known": False,
            "since": self._index + 1,
            "lowest": Fraction(0),
            "highest": Fraction(0),
        }

    def _note_check(self, place: tuple[str, str], target: Fraction, offset: Fraction, *, known: bool) -> None:
        self._checks.append(TargetCheck((*self._place, *place), place[1], target, offset, known))

    def _check_target(self, place: Sequence[str | int], axis: Axis, target: Fraction, offset: Fraction) -> bool:
        name, code, remedy = str(place[1]), "soft-limit", "change the target, or the soft limits in the fleet file"
        text = explain_beyond_limits(name, axis, target, offset)
        if text is None:
            code, remedy = "position-range", "move the other way, or home the axis, which begins to count again"
            text = explain_beyond_range(name, axis, target)
        if text is not None:
            self._add_problem(tuple(place), code, text, remedy, name)
        return text is None

    def _exceeds_room(self, axis: Axis, reached: tuple[Fraction, Fraction]) -> bool:
        """Whether the soft limits are too near to each other for all positions in a range."""
        limits = axis.soft_limits_counts
        return limits is not None and abs(axis.to_counts(reached[1] - reached[0])) > limits[1] - limits[0]

    def _check_room(self, place: Sequence[str | int], axis: Axis, state: AxisForecast) -> bool:
        """Whether the moves by a distance from an unknown position can stay inside the soft limits at all."""
        limits = axis.soft_limits_counts
        if limits is None or not self._exceeds_room(axis, (state.lowest, state.highest)):
            return True
        span = abs(axis.to_unit(axis.to_counts(state.highest - state.lowest)))
        apart = abs(axis.to_unit(limits[1] - limits[0]))
        text = (
            f"axis {place[1]}: the moves from step {state.since} on cover {span:g} {axis.unit}; its soft limits are "
            f"{apart:g} {axis.unit} apart"
        )
        remedy = "move less far, or change the soft limits"
        self._add_problem(tuple(place), "soft-limit", text, remedy, str(place[1]))
        return False

    def _note_room(self, name: str, state: AxisForecast) -> None:
        """The condition that moves by a distance set on the position where they begin."""
        if state.known or state.lowest == state.highest:
            return
        axis = self._fleet.axis(name)
        if axis.soft_limits is None:
            return
        low, high = (parse_quantity(end, axis.unit) for end in (axis.soft_limits.min, axis.soft_limits.max))
        begin, end = float(low - state.lowest), float(high - state.highest)
        self.conditions[
            f"{name} stands between {begin:g} and {end:g} {axis.unit} (motor position) before step {state.since}"
        ] = None

    # Names and states

    def _state(self, name: str) -> AxisForecast:
        known = self.axes.get(name)
        if known is None:
            # Axes that the job enables by itself need no step for it.
            enabled = None if self._fleet.axis(name).enable == "manual" else True
            known = self.axes[name] = AxisForecast(enabled=enabled, since=self._index)
        return known

    def _require_ready(self, name: str, place: tuple[str | int, ...]) -> None:
        self._require(name, "enabled", place)
        self._require(name, "referenced", place)

    def _require(
        self, name: str, what: Literal["enabled", "referenced"], place: tuple[str | int, ...], why: str = ""
    ) -> None:
        """The axis must be enabled, or referenced; unless its controller alone knows, it is a problem or it is not."""
        state = self._state(name)
        found = getattr(state, what)
        if found is None:
            self.conditions[f"{name} is {what} before the job"] = None
        elif not found:
            verb = "enable" if what == "enabled" else "home"
            text = f"{why}, which is not referenced" if why else f"axis {name} is not {what}"
            self._add_problem(place, f"not-{what}", text, f"add a step `do: {verb}` before it", name)
        if not found:
            self.axes[name] = state.model_copy(update={what: True})

    def _find_axis(self, name: str, place: tuple[str | int, ...]) -> Axis | None:
        text = self._fleet.names.explain_unknown(name, "axis")
        if text is None:
            return self._fleet.axis(name)
        self._add_problem(place, "unknown-name", text, "correct the name")
        return None

    def _expand(self, names: Iterable[str], place: tuple[str | int, ...]) -> list[str]:
        """The axes of all names that exist; the others are problems."""
        found: list[str] = []
        for number, name in enumerate(names):
            text = self._fleet.names.explain_unknown(name, "axes")
            if text is None:
                found += self._fleet.expand_name(name)
            else:
                self._add_problem((*place, number), "unknown-name", text, "correct the name")
        return list(dict.fromkeys(found))

    def _parse(self, value: int | float | str, axis: Axis, name: str, place: tuple[str | int, ...]) -> Fraction | None:
        try:
            return parse_quantity(value, axis.unit)
        except UnitError as error:
            self._add_problem(place, "bad-unit", f"{name}: {error}", "correct the unit", name)
            return None

    def _add_problem(
        self, place: tuple[str | int, ...], code: str, text: str, remedy: str, axis: str | None = None
    ) -> None:
        controller = None if axis is None else controller_of(axis)
        problem = StepProblem(
            place=[*self._place, *place], code=code, text=text + self._when, remedy=remedy, controller=controller
        )
        if problem not in self.problems:
            self.problems.append(problem)


def _longest_move(name: str, axis: Axis, after: AxisForecast, order: Order) -> AxisMove | None:
    """The move from the farther soft limit; None without limits."""
    limits = axis.soft_limits_counts
    if limits is None or not after.known:
        return None
    target = axis.to_counts(after.motor)
    return make_axis_move(name, axis, max(limits, key=lambda end: abs(end - target)), target, order)
