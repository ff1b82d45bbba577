"""Run a job forward on paper: positions, limits, names, units and durations of all steps, before anything moves.

Positions that only the machine knows are carried as distances from there, so that a sum of relative moves is compared
with the soft limits although nothing is known about its beginning.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import singledispatchmethod
from typing import Literal, NamedTuple

from orchestrator.model.duration import format_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.fleet_names import suggest_name
from orchestrator.model.forecast import AxisForecast, JobForecast, StepForecast, StepProblem
from orchestrator.model.job import Disable, Dwell, Enable, Home, Move, SetOutput, SetPosition, Step, WaitInput
from orchestrator.model.names import ALL_AXES, controller_of, is_position_name
from orchestrator.model.positions.resolve import PositionResolver, list_file_positions
from orchestrator.model.step_words import describe_step
from orchestrator.model.units import UnitError, parse_quantity
from orchestrator.plan.homing_order import find_prerequisites, homing_order
from orchestrator.plan.shape import PlanError
from orchestrator.plan.step import AxisMove, StepPlan, plan_step
from orchestrator.plan.targets import choose_turn, explain_beyond_limits, explain_beyond_range, make_axis_move

Order = Literal[2, 3]


@dataclass(frozen=True, slots=True)
class ForecastMotion:
    """A motion step in counts, planned from where the steps before it leave its axes."""

    moves: list[AxisMove]
    exact: dict[str, tuple[Fraction, int]]
    plan: StepPlan


class _Span(NamedTuple):
    """A duration, s. most: None if it has no bound."""

    least: float = 0.0
    most: float | None = 0.0


class JobForecaster:
    """Takes the steps of a job one by one; `problems` and `conditions` grow, `axes` is the state after the last one."""

    def __init__(
        self, fleet: Fleet, axes: Mapping[str, AxisForecast] | None = None, orders: Mapping[str, Order] | None = None
    ) -> None:
        """axes: their states now; others are unknown. orders: of the profiles that each controller executes."""
        self._fleet = fleet
        self._orders = orders or {}
        self._outputs: dict[str, bool] = {}
        self._reserved = _find_reserved_outputs(fleet)
        self.axes: dict[str, AxisForecast] = dict(axes or {})
        self.problems: list[StepProblem] = []
        self.conditions: dict[str, None] = {}
        self.motion: ForecastMotion | None = None
        """The step that was taken last, if it moves and all its positions are known."""
        self._index = 0
        self._notes: list[str] = []

    def take(self, index: int, step: Step) -> StepForecast:
        """Run one step forward. index: its number in the job file."""
        self._index, self._notes, self.motion = index, [], None
        span = self._run(step)
        return StepForecast(
            index=index,
            do=step.do,
            text=describe_step(step),
            least_s=round(span.least, 6),
            most_s=None if span.most is None else round(span.most, 6),
            conditions=self._notes,
        )

    def add_refusal(self, index: int, error: Refusal) -> None:
        """Add a problem of a whole step. index: its number in the job file."""
        self._index = index
        self._add_problem((), error.code, error.text, error.remedy)

    def finish(self, steps: Iterable[StepForecast] = ()) -> JobForecast:
        """The forecast of the job whose steps were taken."""
        for name, state in self.axes.items():
            self._note_room(name, state)
        return JobForecast(steps=list(steps), problems=self.problems, conditions=list(self.conditions))

    # Steps

    @singledispatchmethod
    def _run(self, step: Step) -> _Span:
        raise AssertionError(f"no forecast for {step!r}")

    @_run.register
    def _(self, step: Move) -> _Span:
        known = self._leave_names(step)
        if known is not step:
            return _Span(self._run(known).least if known.to or known.by else 0.0, None)
        nearest: list[AxisMove] = []
        farthest: list[AxisMove] = []
        exact: dict[str, tuple[Fraction, int]] = {}
        bounded = True
        for name, value in (step.to | step.by).items():
            place = ("by" if name in step.by else "to", name)
            axis = self._find_axis(name, place)
            amount = None if axis is None else self._parse(value, axis, name, place)
            if axis is None or amount is None:
                continue
            self._require_ready(name, place)
            before = self._state(name)
            after, distance_known = self._find_target(place, axis, amount)
            self.axes[name] = after
            order = self._orders.get(controller_of(name), 2 if axis.limits.jerk is None else 3)
            if distance_known:
                start, target = axis.to_counts(before.motor), axis.to_counts(after.motor)
                move = make_axis_move(name, axis, start, target, order)
                nearest.append(move)
                farthest.append(move)
                if before.known and after.known:
                    exact[name] = (after.motor, target)
            elif (most := _longest_move(name, axis, after, order)) is not None:
                farthest.append(most)
            else:
                bounded = False
        return self._plan_move(step, nearest, farthest if bounded else None, exact)

    @_run.register
    def _(self, step: Home) -> _Span:
        names = step.axes
        if names is not None:
            self._expand(names, ("axes",))
            names = [name for name in names if self._fleet.names.explain_unknown(name, "axes") is None]
        order = homing_order(self._fleet, names)
        try:
            waits = find_prerequisites(self._fleet, order)
        except Refusal as error:
            self._add_problem((), error.code, error.text, error.remedy)
            return _Span()
        for axis, others in waits.items():
            for other in sorted(others - waits.keys()):
                self._require(other, "referenced", (), f"{axis} must be homed after {other} (homing.after)")
        for axis in waits:
            self._require(axis, "enabled", ())
            self._note_room(axis, self._state(axis))
            state = self._state(axis)
            kind = "unknown" if state.offset_kind == "start" else state.offset_kind
            self.axes[axis] = state.model_copy(
                update={"motor": Fraction(0), "known": True, "referenced": True, "offset_kind": kind}
            )
        entries = [*order.entries, *([axis] for axis in order.loners)]
        most = sum(max(self._fleet.axis(axis).homing.timeout_s for axis in entry) for entry in entries)
        self._notes.append(f"the reference is found within {most:g} s")
        return _Span(0.0, most)

    @_run.register
    def _(self, step: Enable) -> _Span:
        return self._switch(step, on=True)

    @_run.register
    def _(self, step: Disable) -> _Span:
        return self._switch(step, on=False)

    @_run.register
    def _(self, step: SetPosition) -> _Span:
        for name, value in step.axes.items():
            place = ("axes", name)
            axis = self._find_axis(name, place)
            amount = Fraction(0) if axis is None or value is None else self._parse(value, axis, name, place)
            if axis is None or amount is None:
                continue
            state = self._state(name)
            update: dict[str, object] = {"offset": Fraction(0), "offset_kind": "motor"}
            if value is not None:
                update = {"offset": amount - state.motor, "offset_kind": "motor" if state.known else "start"}
            self.axes[name] = state.model_copy(update=update)
        return _Span()

    @_run.register
    def _(self, step: Dwell) -> _Span:
        return _Span(step.duration / 1e9, step.duration / 1e9)

    @_run.register
    def _(self, step: SetOutput) -> _Span:
        text = self._fleet.names.explain_unknown(step.output, "output")
        if text is not None:
            self._add_problem(("output",), "unknown-name", text, "correct the name")
        elif step.output in self._reserved:
            purpose = self._reserved[step.output]
            self._add_problem(
                ("output",),
                "output-in-use",
                f"output {step.output} is {purpose}, which switches it by itself",
                "use another output, or remove that use from the fleet file",
            )
        elif self._outputs.get(step.output) == step.value:
            self._notes.append(f"{step.output} is {'active' if step.value else 'inactive'} already")
        wired = [end for wire in self._fleet.wiring if wire.from_ == step.output for end in wire.to]
        if step.value and wired:
            self._notes.append(f"no controller waits for {', '.join(wired)}, which the output is wired to")
        self._outputs[step.output] = step.value
        return _Span()

    @_run.register
    def _(self, step: WaitInput) -> _Span:
        text = self._fleet.names.explain_unknown(step.input, "input")
        if text is not None:
            self._add_problem(("input",), "unknown-name", text, "correct the name")
        state = "active" if step.value else "inactive"
        self._notes.append(f"input {step.input} becomes {state} within {format_ns(step.timeout)}")
        return _Span(0.0, step.timeout / 1e9)

    # Parts of steps

    def _leave_names(self, step: Move) -> Move:
        """The move without the targets that name positions which only the running fleet knows; where these axes will
        be is not known then. The step itself if it has none."""
        named = {axis: str(target) for axis, target in step.to.items() if is_position_name(target)}
        if not named:
            return step
        for axis, name in named.items():
            hint = suggest_name(name, self._fleet.names.positions).strip()
            known = f"position {name} is saved in the running fleet"
            self.conditions[f"{known} ({hint})" if hint else known] = None
            for each in list(self.axes) if axis == ALL_AXES else [axis]:
                if axis == ALL_AXES or self._find_axis(axis, ("to", axis)) is not None:
                    self.axes[each] = self._state(each).model_copy(update=self._unknown_position())
        return step.model_copy(update={"to": {axis: to for axis, to in step.to.items() if axis not in named}})

    def _switch(self, step: Enable | Disable, *, on: bool) -> _Span:
        axes = self._expand(step.axes, ("axes",))
        for axis in axes:
            self.axes[axis] = self._state(axis).model_copy(update={"enabled": on})
        brakes = [brake for axis in axes if (brake := self._fleet.axis(axis).brake) is not None]
        longest_s = max((brake.release_s if on else brake.engage_s for brake in brakes), default=0.0)
        return _Span(longest_s, longest_s)

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
            self._check_target(place, axis, target, state.offset)
            self.conditions["user offsets (`set-position`) are 0 where no step sets them"] = None
            return state.model_copy(update={"motor": target, "known": True}), False
        else:
            target = choose_turn(axis, state.motor, amount - state.offset, state.offset)
        update: dict[str, object] = {"motor": target}
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

    def _check_target(self, place: tuple[str, str], axis: Axis, target: Fraction, offset: Fraction) -> bool:
        name, code, remedy = place[1], "soft-limit", "change the target, or the soft limits in the fleet file"
        text = explain_beyond_limits(name, axis, target, offset)
        if text is None:
            code, remedy = "position-range", "move the other way, or home the axis, which begins to count again"
            text = explain_beyond_range(name, axis, target)
        if text is not None:
            self._add_problem(place, code, text, remedy, name)
        return text is None

    def _check_room(self, place: tuple[str, str], axis: Axis, state: AxisForecast) -> bool:
        """Whether the moves by a distance from an unknown position can stay inside the soft limits at all."""
        limits = axis.soft_limits_counts
        if limits is None:
            return True
        room, needed = limits[1] - limits[0], abs(axis.to_counts(state.highest - state.lowest))
        if needed <= room:
            return True
        span, apart = abs(axis.to_unit(needed)), abs(axis.to_unit(room))
        text = (
            f"axis {place[1]}: the moves from step {state.since} on cover {span:g} {axis.unit}; its soft limits are "
            f"{apart:g} {axis.unit} apart"
        )
        self._add_problem(place, "soft-limit", text, "move less far, or change the soft limits", place[1])
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

    def _plan_move(
        self,
        step: Move,
        nearest: list[AxisMove],
        farthest: list[AxisMove] | None,
        exact: dict[str, tuple[Fraction, int]],
    ) -> _Span:
        try:
            plan = longest = plan_step(nearest, step.sync, step.speed, step.ramps)
            if farthest is not None and farthest != nearest:
                longest = plan_step(farthest, step.sync, step.speed, step.ramps)
        except PlanError as error:
            self._add_problem((), "plan", str(error), "")
            return _Span()
        if len(exact) == len(step.to) + len(step.by):
            self.motion = ForecastMotion(nearest, exact, plan)
        return _Span(plan.duration_s, None if farthest is None else longest.duration_s)

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
            place=["steps", self._index, *place], code=code, text=text, remedy=remedy, controller=controller
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


def _find_reserved_outputs(fleet: Fleet) -> dict[str, str]:
    """Outputs that jobs may not switch, with what they are."""
    reserved: dict[str, str] = {}
    for controller, config in fleet.controllers.items():
        for name, axis in config.axes.items():
            if axis.brake is not None and axis.brake.output is not None:
                reserved[f"{controller}.{axis.brake.output}"] = f"the brake of {controller}.{name}"
    return reserved


def forecast_job(
    fleet: Fleet, steps: list[Step], repeat: int = 1, on_step: Callable[[int], None] | None = None
) -> JobForecast:
    """Run all steps forward from an unknown beginning, by the positions of the fleet file. on_step: called with the
    number of steps done."""
    forecaster = JobForecaster(fleet)
    resolver = PositionResolver(fleet, list_file_positions(fleet))
    found: list[StepForecast] = []
    for _ in range(repeat):
        for index, step in enumerate(steps):
            try:
                known = resolver.resolve_known(step)
            except Refusal as error:
                forecaster.add_refusal(index, error)
                known = step
            found.append(forecaster.take(index, known))
            if on_step is not None:
                on_step(len(found))
    return forecaster.finish(found)
