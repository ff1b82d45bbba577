"""Run a job forward on paper: positions, limits, names, units and durations of all steps, before anything moves.

Positions that only the machine knows are carried as distances from there, so that a sum of relative moves is compared
with the soft limits although nothing is known about its beginning.
"""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial, singledispatchmethod
from typing import NamedTuple

from orchestrator.model.duration import format_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.fleet_names import suggest_name
from orchestrator.model.forecast import AxisForecast, JobForecast, StepForecast
from orchestrator.model.job import (
    Disable,
    Dwell,
    Enable,
    FollowPath,
    Home,
    Latch,
    MotionOptions,
    Move,
    Repeat,
    Scan,
    SetOutput,
    SetPosition,
    Step,
    WaitInput,
)
from orchestrator.model.names import ALL_AXES, controller_of, is_position_name
from orchestrator.model.operation.step_words import describe_step
from orchestrator.model.positions.resolve import (
    PositionResolver,
    iterate_targets,
    list_file_positions,
    replace_targets,
)
from orchestrator.model.units import UnitError
from orchestrator.plan.forecast_axes import AxisForecaster, MoveWays, Order
from orchestrator.plan.forecast_passes import (
    RUN_PASSES,
    LaterTarget,
    TargetCheck,
    find_first_pass,
    find_last_state,
    find_later_targets,
    find_range,
    group_by_axis,
)
from orchestrator.plan.homing_order import find_prerequisites, homing_order
from orchestrator.plan.path_step import PathStart, PlannedPath, find_start, plan_path_step
from orchestrator.plan.scan_ways import ScanCorner, ScanWays, find_corners, iterate_ways
from orchestrator.plan.shape import PlanError
from orchestrator.plan.step import AxisMove, StepPlan, plan_step
from orchestrator.plan.targets import explain_beyond_limits, explain_beyond_range, make_axis_move
from orchestrator.plan.triggers import ResolvedTrigger, find_brake_outputs, resolve_triggers


@dataclass(frozen=True, slots=True)
class ForecastMotion:
    """A motion step in counts, planned from where the steps before it leave its axes."""

    moves: list[AxisMove]
    exact: Mapping[str, tuple[Fraction, int]]
    plan: StepPlan
    path: PlannedPath | None = None
    triggers: Sequence[ResolvedTrigger] = ()


class _Span(NamedTuple):
    """A duration, s. most: None if it has no bound."""

    least: float = 0.0
    most: float | None = 0.0

    def followed_by(self, other: "_Span", times: int = 1) -> "_Span":
        """The duration of this and then `other`, so many times."""
        most = None if self.most is None or other.most is None else self.most + other.most * times
        return _Span(self.least + other.least * times, most)


class _Pass(NamedTuple):
    """One pass of repeated steps: the targets that were checked, the axes after it, its duration, new problems."""

    checks: list[TargetCheck]
    axes: dict[str, AxisForecast]
    span: _Span
    problems: int


class JobForecaster(AxisForecaster):
    """Takes the steps of a job one by one; `problems` and `conditions` grow, `axes` is the state after the last one."""

    def __init__(
        self, fleet: Fleet, axes: Mapping[str, AxisForecast] | None = None, orders: Mapping[str, Order] | None = None
    ) -> None:
        """axes: their states now; others are unknown. orders: of the profiles that each controller executes."""
        super().__init__(fleet, axes, orders)
        self._outputs: dict[str, bool] = {}
        self._reserved = find_brake_outputs(fleet)
        self.motion: ForecastMotion | None = None
        """The step that was taken last, if it moves and all its positions are known."""
        self._notes: dict[str, None] = {}

    def take(self, index: int, step: Step) -> StepForecast:
        """Run one step forward. index: its number in the job file."""
        work = self.take_in_parts(index, step)
        while True:
            try:
                next(work)
            except StopIteration as done:
                return done.value

    def take_in_parts(self, index: int, step: Step) -> Generator[None, None, StepForecast]:
        """`take`, with a break before each step inside a repeat or a scan, for the other work of a process."""
        self._index, self._notes, self.motion = index, {}, None
        self._place, self._checks = ("steps", index), []
        span = yield from self._run_parts(step)
        if not isinstance(step, Move | FollowPath):
            self.motion = None
        path = None if self.motion is None or self.motion.path is None else self.motion.path.report
        return StepForecast(
            index=index,
            do=step.do,
            text=describe_step(step),
            least_s=round(span.least, 6),
            most_s=None if span.most is None else round(span.most, 6),
            conditions=list(self._notes),
            path=path,
        )

    def add_refusal(self, index: int, error: Refusal) -> None:
        """Add a problem of a whole step. index: its number in the job file."""
        self._index, self._place = index, ("steps", index)
        self._add_problem((), error.code, error.text, error.remedy)

    def finish(self, steps: Iterable[StepForecast] = ()) -> JobForecast:
        """The forecast of the job whose steps were taken."""
        for name, state in self.axes.items():
            self._note_room(name, state)
        return JobForecast(steps=list(steps), problems=self.problems, conditions=list(self.conditions))

    def _run_parts(self, step: Step) -> Generator[None, None, _Span]:
        yield
        if isinstance(step, Repeat):
            return (yield from self._run_passes(step.steps, "steps", step.times, "in pass"))
        span = self._run(step)
        if isinstance(step, Scan):
            span = span.followed_by(
                (yield from self._run_passes(step.at_each, "at_each", step.point_count, "at point"))
            )
        return span

    # Steps

    @singledispatchmethod
    def _run(self, step: Step) -> _Span:
        raise AssertionError(f"no forecast for {step!r}")

    @_run.register
    def _(self, step: Move) -> _Span:
        if step.record is not None:
            self._expand(step.record.axes, ("record", "axes"))
        unknown = self._note_unknown_positions(step)
        if unknown:
            named = [axis for axis in unknown if axis != ALL_AXES and self._find_axis(axis, ("to", axis)) is not None]
            self._lose_positions(list(self.axes) if ALL_AXES in unknown else named)
            known = step.model_copy(update={"to": {axis: to for axis, to in step.to.items() if axis not in unknown}})
            return _Span(self._run(known).least if known.to or known.by else 0.0, None)
        ways = MoveWays()
        for name, value in (step.to | step.by).items():
            place = ("by" if name in step.by else "to", name)
            axis = self._find_axis(name, place)
            amount = None if axis is None else self._parse(value, axis, name, place)
            if axis is None or amount is None:
                continue
            self._require_ready(name, place)
            self._take_target(ways, place, axis, amount)
        span = self._plan_ways(step, ways)
        if ways.plan is not None and len(ways.exact) == len(step.to) + len(step.by):
            self.motion = ForecastMotion(ways.nearest, ways.exact, ways.plan)
        self._check_triggers(step)
        return span

    @_run.register
    def _(self, step: FollowPath) -> _Span:
        if step.record is not None:
            self._expand(step.record.axes, ("record", "axes"))
        found = {name: self._find_axis(name, ("axes", number)) for number, name in enumerate(step.axes)}
        axes = {name: axis for name, axis in found.items() if axis is not None}
        for name in axes:
            self._require_ready(name, ("axes",))
        if len(axes) < len(found):
            return _Span()
        try:
            path = plan_path_step(step, self._place_path(step, axes), self._fleet.frames)
        except (Refusal, PlanError) as error:
            code, text, remedy = ("plan", str(error), "")
            if isinstance(error, Refusal):
                code, text, remedy = error.code, error.text, error.remedy
            self._add_problem((), code, text, remedy)
            self._lose_positions(axes)
            return _Span()
        for name, (end, _) in path.exact.items():
            self.axes[name] = self._state(name).model_copy(update={"motor": end, "known": True})
        self.motion = ForecastMotion(path.moves, path.exact, path.plan, path)
        self._check_triggers(step)
        return _Span(path.plan.duration_s, path.plan.duration_s)

    def _check_triggers(self, step: Move | FollowPath) -> None:
        """Check outputs and units of triggers, and their instants where the motion is known."""
        try:
            resolved = resolve_triggers(self._fleet, step.triggers, lambda axis: self._state(axis).offset)
            if self.motion is not None:
                for trigger in resolved:
                    trigger.find_instants_ns(self.motion.plan)
                self.motion = replace(self.motion, triggers=resolved)
        except Refusal as error:
            self._add_problem(("triggers",), error.code, error.text, error.remedy)

    def _place_path(self, step: FollowPath, axes: Mapping[str, Axis]) -> list[PathStart]:
        """Where the axes of a path are before it: an axis whose position is not known must be at its start."""
        placed: list[PathStart] = []
        begin = find_start(step, [axis.unit for axis in axes.values()], self._fleet.frames)
        for value, at, (name, axis) in zip(step.start, begin, axes.items(), strict=True):
            state = self._state(name)
            here = state.motor
            if not state.known or state.offset_kind != "motor":
                where = value if step.frame is None else f"{float(at):.6g} {axis.unit}"
                self._notes[f"{name} stands at {where} when the path begins"] = None
                here = at - state.offset
            order = self._orders.get(controller_of(name), 3)
            placed.append(PathStart(name, axis, here, axis.to_counts(here), state.offset, order))
        return placed

    @_run.register
    def _(self, step: Scan) -> _Span:
        axes = {name: self._find_axis(name, ("axes", name)) for name in step.axis_names}
        known = {name: axis for name, axis in axes.items() if axis is not None}
        if len(known) < len(axes):
            return _Span()
        units = [axis.unit for axis in known.values()]
        for column in step.points.columns if step.points is not None else ():
            if column.unit != known[column.axis].unit:
                text = f"the points of {column.axis} are in {column.unit}, and the axis is in {known[column.axis].unit}"
                self._add_problem(("points",), "bad-unit", text, "submit the job again", column.axis)
                return _Span()
        unknown = self._note_unknown_positions(step)
        if unknown:
            step = replace_targets(step, lambda _, target: 0 if is_position_name(target) else target)
        try:
            corners, kinds = find_corners(step, units, unknown), list(iterate_ways(step, units))
        except UnitError as error:
            self._add_problem((), "bad-unit", str(error), "correct the unit")
            return _Span()
        first, sure = MoveWays(), {name: axis for name, axis in known.items() if name not in unknown}
        for name, axis in sure.items():
            self._take_corners(first, name, axis, corners[name], step.point_count)
        span = self._plan_ways(step, first)
        for kind in kinds:
            span = span.followed_by(self._plan_kind(step, sure, kind), kind.often)
        self._lose_positions(unknown)
        return _Span(span.least, None) if unknown else span

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
        self._notes[f"the reference is found within {most:g} s"] = None
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
            self._notes[f"{step.output} is {'active' if step.value else 'inactive'} already"] = None
        wired = [end for wire in self._fleet.wiring if wire.from_ == step.output for end in wire.to]
        if step.value and wired:
            self._notes[f"no controller waits for {', '.join(wired)}, which the output is wired to"] = None
        self._outputs[step.output] = step.value if step.pulse is None else not step.value
        pulse_s = (step.pulse or 0) / 1e9
        return _Span(pulse_s, pulse_s)

    @_run.register
    def _(self, step: WaitInput) -> _Span:
        text = self._fleet.names.explain_unknown(step.input, "input")
        if text is not None:
            self._add_problem(("input",), "unknown-name", text, "correct the name")
        state = "active" if step.value else "inactive"
        self._notes[f"input {step.input} becomes {state} within {format_ns(step.timeout)}"] = None
        return _Span(0.0, step.timeout / 1e9)

    @_run.register
    def _(self, step: Latch) -> _Span:
        self._find_axis(step.axis, ("axis",))
        text = self._fleet.names.explain_unknown(step.input, "input")
        if text is not None:
            self._add_problem(("input",), "unknown-name", text, "correct the name")
        self._notes[f"input {step.input} latches {step.axis} within {format_ns(step.timeout)}"] = None
        return _Span(0.0, step.timeout / 1e9)

    # Passes

    def _run_passes(self, steps: Sequence[Step], key: str, times: int, word: str) -> Generator[None, None, _Span]:
        """Run steps forward `times` times: the first passes, the others by what these differ in, and the last one. key:
        of the steps in their own step. word: what a pass is called in messages."""
        when = self._when
        passes: list[_Pass] = []
        whole = _Span()
        for number in range(1, min(times, RUN_PASSES) + 1):
            words = f", {word} {number} of {times}{when}" if number > 1 else when
            passes.append((yield from self._run_pass(steps, key, words)))
            whole = whole.followed_by(passes[-1].span)
            if passes[-1].problems:
                return whole  # it would be there in every pass
        if times <= RUN_PASSES:
            return whole
        third, problems = passes[-1].span, len(self.problems)
        self._skip_passes(passes, times - 1, lambda number: f", {word} {number} of {times}{when}")
        if len(self.problems) > problems:
            return whole
        targets = find_later_targets(passes[1].checks, passes[2].checks)
        if not any(each.drift or each.offset_drift for each in targets):
            return whole.followed_by(third, times - RUN_PASSES)
        last = (yield from self._run_pass(steps, key, f", {word} {times} of {times}{when}")).span
        between = third
        if last != third:
            # A way that changes from pass to pass is longest at one end; it may be nothing in between.
            most = None if third.most is None or last.most is None else max(third.most, last.most)
            between = _Span(0.0, most)
        return whole.followed_by(between, times - RUN_PASSES - 1).followed_by(last)

    def _run_pass(self, steps: Sequence[Step], key: str, when: str) -> Generator[None, None, "_Pass"]:
        """Run steps forward once."""
        place, outer = self._place, (self._checks, self._when)
        problems, span = len(self.problems), _Span()
        self._checks, self._when = [], when
        for index, step in enumerate(steps):
            self._place = (*place, key, index)
            span = span.followed_by((yield from self._run_parts(step)))
        made = _Pass(self._checks, dict(self.axes), span, len(self.problems) - problems)
        self._place, (self._checks, self._when) = place, outer
        self._checks += made.checks
        return made

    def _skip_passes(
        self,
        passes: Sequence["_Pass"],
        times: int,
        describe: Callable[[int], str],
    ) -> None:
        """Go on from the third pass to pass `times`. describe: a pass in words."""
        _, (second, before, _, _), (third, after, _, _) = passes
        place, when = self._place, self._when
        for name, targets in group_by_axis(find_later_targets(second, third)).items():
            axis, state = self._fleet.axis(name), after[name]
            problems = len(self.problems)
            for number, check in self._find_leaving_targets(axis, targets, times).values():
                self._place, self._when = check.place[:-2], describe(number)
                self._check_target(check.place[-2:], axis, check.target, check.offset)
            # A position that was lost in each pass is no common beginning.
            lost = state.since > self._index
            apart = [each for each in targets if not each.check.known and not lost]
            number = find_first_pass(times, partial(self._leaves_room, axis, state, apart)) if apart else None
            if number is not None:
                self._place, self._when = apart[-1].check.place[:-2], describe(number)
                lowest, highest = find_range(state, apart, number)
                reached = state.model_copy(update={"lowest": lowest, "highest": highest})
                self._check_room(apart[-1].check.place[-2:], axis, reached)
            self.axes[name] = find_last_state(before[name], state, apart, times)
            if len(self.problems) > problems:
                self.axes[name] = state.model_copy(update=self._unknown_position())
            self._checks += [each.in_pass(times) for each in targets]
        self._place, self._when = place, when

    def _find_leaving_targets(
        self, axis: Axis, targets: Sequence[LaterTarget], times: int
    ) -> dict[tuple[str | int, ...], tuple[int, TargetCheck]]:
        """By place: the first pass in which a target is out of reach, and that target."""
        found: dict[tuple[str | int, ...], tuple[int, TargetCheck]] = {}
        for each in targets:
            if each.check.known and (each.drift or each.offset_drift):
                number = find_first_pass(times, partial(self._leaves_limits, axis, each))
                if number is not None and number < found.get(each.check.place, (times + 1, None))[0]:
                    found[each.check.place] = number, each.in_pass(number)
        return found

    def _leaves_limits(self, axis: Axis, target: LaterTarget, number: int) -> bool:
        check = target.in_pass(number)
        beyond = explain_beyond_limits(check.axis, axis, check.target, check.offset)
        return (beyond or explain_beyond_range(check.axis, axis, check.target)) is not None

    def _leaves_room(self, axis: Axis, state: AxisForecast, targets: Sequence[LaterTarget], number: int) -> bool:
        return self._exceeds_room(axis, find_range(state, targets, number))

    # Parts of steps

    def _take_corners(
        self, first: "MoveWays", name: str, axis: Axis, corners: Sequence[ScanCorner], points: int
    ) -> None:
        """Move one axis of a scan to its extremes. first: gets the way to the first point."""
        self._require_ready(name, ("axes", name))
        when, ways, seen = self._when, first, set[Fraction]()
        for number, corner in enumerate(corners):
            last = number == len(corners) - 1
            if corner.position in seen and not last:
                continue
            problems = () if corner.position not in seen else tuple(self.problems)
            seen.add(corner.position)
            words = ", ".join(f"{axis} {value:g}" for axis, value in corner.positions.items())
            self._when = f", at point {corner.point} of {points} ({words}){when}"
            self._take_target(ways, ("axes", name), axis, corner.position)
            if problems:
                self.problems = list(problems)  # the corner was reported before
            ways = MoveWays()
        self._when = when

    def _plan_kind(self, step: Scan, axes: Mapping[str, Axis], kind: ScanWays) -> _Span:
        """The duration of one kind of way between points."""
        ways = MoveWays()
        for name, axis in axes.items():
            for found, moves in ((kind.nearest, ways.nearest), (kind.farthest, ways.farthest)):
                if name in found:
                    start, target = (axis.to_counts(each) for each in found[name])
                    moves.append(make_axis_move(name, axis, start, target, self._order_of(name, axis)))
        return self._plan_ways(step, ways)

    def _note_unknown_positions(self, step: Move | Scan) -> list[str]:
        """Note the positions that only the running fleet knows; return the axes that the step moves there."""
        axes: dict[str, None] = {}
        for axis, target in iterate_targets(step):
            if is_position_name(target):
                axes[axis] = None
                hint = suggest_name(str(target), self._fleet.names.positions).strip()
                known = f"position {target} is saved in the running fleet"
                self.conditions[f"{known} ({hint})" if hint else known] = None
        return list(axes)

    def _lose_positions(self, axes: Iterable[str]) -> None:
        for each in axes:
            self.axes[each] = self._state(each).model_copy(update=self._unknown_position())

    def _switch(self, step: Enable | Disable, *, on: bool) -> _Span:
        axes = self._expand(step.axes, ("axes",))
        for axis in axes:
            self.axes[axis] = self._state(axis).model_copy(update={"enabled": on})
        brakes = [brake for axis in axes if (brake := self._fleet.axis(axis).brake) is not None]
        longest_s = max((brake.release_s if on else brake.engage_s for brake in brakes), default=0.0)
        return _Span(longest_s, longest_s)

    def _plan_ways(self, step: MotionOptions, ways: "MoveWays") -> _Span:
        """The duration of a motion; its plan stays in `ways`."""
        try:
            plan = longest = plan_step(ways.nearest, step.sync, step.speed, step.ramps)
            if ways.bounded and ways.farthest != ways.nearest:
                longest = plan_step(ways.farthest, step.sync, step.speed, step.ramps)
        except PlanError as error:
            self._add_problem((), "plan", str(error), "")
            return _Span()
        ways.plan = plan
        return _Span(plan.duration_s, longest.duration_s if ways.bounded else None)


def forecast_job(
    fleet: Fleet, steps: list[Step], repeat: int = 1, on_step: Callable[[int], None] | None = None
) -> JobForecast:
    """Run all steps forward from an unknown beginning, by the positions of the fleet file. on_step: called with the
    number of steps done."""
    forecaster = JobForecaster(fleet)
    resolver = PositionResolver(fleet, list_file_positions(fleet), keep_unknown=True)
    found: list[StepForecast] = []
    for _ in range(repeat):
        for index, step in enumerate(steps):
            try:
                known = resolver.resolve_step(step)
            except Refusal as error:
                forecaster.add_refusal(index, error)
                known = step
            found.append(forecaster.take(index, known))
            if on_step is not None:
                on_step(len(found))
    return forecaster.finish(found)
