"""Planning of a motion step: from the present state of the axes to profiles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

from orchestrator.bus.base import BusError
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.owner import call_for_each
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.fleet.zones import ZoneMover
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.targets import AxisContext, ResolvedMove, make_path_starts, resolve_targets
from orchestrator.model.compensation import Play
from orchestrator.model.errors import SETTING_CHANGED, Refusal
from orchestrator.model.fleet import TriggerWire
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.parts import find_long_paths
from orchestrator.model.names import controller_of
from orchestrator.model.report import PairBound
from orchestrator.model.state import AxisState, ControllerInfo, ControllerState, StartWish
from orchestrator.model.steps.armed_terms import ArmedTerms
from orchestrator.model.steps.kinds import Motion
from orchestrator.model.steps.path import FollowPath
from orchestrator.plan.curved_move import CurvedMove, plan_curved_move
from orchestrator.plan.flying.path import FlightPath, place_triggers, plan_flight_step
from orchestrator.plan.pairs import bound_pairs, require_whole_pairs
from orchestrator.plan.path_course import ChunkPlan
from orchestrator.plan.path_step import PlannedPath, plan_path_step
from orchestrator.plan.shape import PlanError
from orchestrator.plan.speeds import plan_motion
from orchestrator.plan.step import StepPlan, plan_step
from orchestrator.plan.triggers import ResolvedTrigger, resolve_triggers
from orchestrator.plan.virtual_bound import CurvedLine
from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.course import Sweep, Timing
from orchestrator.plan.zones.paths import bound_alone, find_path_terms

MAX_TICK_RESIDUAL = 0.02  # of a tick: T0 advances by as many ticks as the members' crystals stay this close together
WAIT_TICK_RESIDUAL = 0.3  # the same for a step that waits armed, whose T0 advances by seconds; far from half a tick
MAX_REST_COUNTS = 1  # by which an axis may stand beside the place where its path was braked: rounding


@dataclass(frozen=True, slots=True)
class StepRequest:
    """A motion step of a job: step number `index`, the move or path, and the job with its defaults. move: as it is
    planned (`straighten`). axes: the real ones that it moves. wait: the terms on which it waits armed."""

    job_id: str
    job: Job
    index: int
    move: Motion
    axes: Sequence[str]
    wait: ArmedTerms | None = None

    def choose_wires(self, wiring: Sequence[TriggerWire]) -> Sequence[TriggerWire]:
        """The trigger lines that may start it: none where it waits armed, because their T0 cannot be brought
        forward."""
        return wiring if self.wait is None else ()

    @property
    def tick_share(self) -> float:
        """Of a tick, how far the members' ticks may drift apart over an advance of T0."""
        return MAX_TICK_RESIDUAL if self.wait is None else WAIT_TICK_RESIDUAL

    @property
    def start_class(self) -> StartWish:
        """The start class that it asks for."""
        return self.move.start_wish

    @property
    def is_synchronised(self) -> bool:
        """Whether all axes take one duration."""
        return self.move.is_synchronised

    @property
    def max_start_skew_ns(self) -> int:
        """The allowed start skew."""
        return self.move.max_start_skew or self.job.max_start_skew

    @property
    def max_end_skew_ns(self) -> int | None:
        """The allowed end skew, None if neither step nor job states one."""
        return self.move.max_end_skew or self.job.max_end_skew

    @property
    def max_path_skew_ns(self) -> int | None:
        """The allowed path skew, None if neither step nor job states one."""
        return self.move.max_path_skew or self.job.max_path_skew


@dataclass(frozen=True, slots=True)
class PlannedStep:
    """A step with its profiles as first planned. instances: of the adapters that it was planned with, by controller.

    ends: where axes will be after it, with those of the steps before that are not over yet. plays: how far axes are
    ahead of their motors there. rehearsal: it starts where
    the steps before it will leave its axes; it is proposed, and never armed. path: of a path. begun_s: where on it the
    motion begins, in its time: after a feed hold, not at its start. rate: the feed override then. elapsed_ns: how long
    it was moved along before. triggers: of the step. pairs: how far pairs may be racked after any single fault. recent:
    where axes of zones may have stopped shortly before its end.
    """

    request: StepRequest
    resolved: ResolvedMove
    plan: StepPlan
    instances: Mapping[str, str]
    ends: Mapping[str, tuple[Fraction, int]] = field(default_factory=dict[str, tuple[Fraction, int]])
    plays: Mapping[str, Play] = field(default_factory=dict[str, Play])
    rehearsal: bool = False
    path: PlannedPath | None = None
    begun_s: float = 0.0
    rate: float = 1.0
    elapsed_ns: int = 0
    triggers: Sequence[ResolvedTrigger] = ()
    pairs: Mapping[str, PairBound] = field(default_factory=dict[str, PairBound])
    recent: Box = field(default_factory=dict[str, tuple[float, float]])

    @property
    def line(self) -> CurvedLine | None:
        """The line of curved virtual axes that it moves."""
        return None if self.path is None else self.path.line


async def plan_request(
    services: MotionServices, request: StepRequest, goal: Mapping[str, Fraction], seen_ns: int | None
) -> PlannedStep:
    """Plan a step from where its axes stand. Raises `Refusal`.

    goal: exact targets from before a feed hold. seen_ns: since when nothing has been done with the axes; None: unknown.
    """
    names = request.axes
    view = services.fleet.view
    controllers = list(dict.fromkeys(controller_of(name) for name in names))
    states: dict[str, AxisState] = {}
    infos: dict[str, ControllerInfo] = {}
    instances: dict[str, str] = {}
    answers = await call_for_each(lambda controller: _query_controller(view, controller, seen_ns), controllers)
    for controller, (state, info) in zip(controllers, answers, strict=True):
        infos[controller], instances[controller] = info, state.instance
        states |= {f"{controller}.{axis}": axis_state for axis, axis_state in state.axes.items()}
    context = AxisContext(view.fleet, states, infos, services.targets)
    planned_step = await _plan_from(services, request, context, goal, instances)
    return await _require_zones(services, planned_step, infos)


def plan_take_up(planned: PlannedStep) -> PlannedStep:
    """The motion before a step by which motors take up the play of their drives: its axes do not move."""
    moves = planned.resolved.take_ups
    # Nothing of the step has happened behind it, and its axes stand where they stood.
    return replace(planned, resolved=ResolvedMove(moves, {}), plan=plan_step(moves, "none", 1.0, "own"), triggers=())


@dataclass(frozen=True, slots=True)
class PathRest:
    """Where a path was braked: at `path_s` of its own time, `moved_ns` after T0. planned: the step as it was planned.
    rate: its feed override."""

    planned: PlannedStep
    path_s: float
    moved_ns: int
    counts: Mapping[str, int]
    rate: float

    @classmethod
    def behind(cls, planned: PlannedStep, chunk: ChunkPlan, rate: float) -> "PathRest":
        """Where the tail of a chunk ends. rate: the feed override."""
        counts = {axis: profile.end_counts for axis, profile in chunk.profiles.items()}
        return cls(planned, chunk.stop_path_s, round(chunk.stop_s * NS_PER_S), counts, rate)


async def plan_resumed(services: MotionServices, rest: PathRest) -> PlannedStep:
    """Plan the rest of a path from where its axes were braked on it. Raises `Refusal`."""
    planned_step, view = rest.planned, services.fleet.view
    assert planned_step.path is not None and planned_step.path.course is not None
    services.fleet.permits.require(planned_step.request.axes)
    counts: dict[str, int] = {}
    infos: dict[str, ControllerInfo] = {}
    instances: dict[str, str] = {}
    for controller in dict.fromkeys(map(controller_of, rest.counts)):
        state, infos[controller] = await _query_controller(view, controller, None)
        instances[controller] = state.instance
        counts |= {f"{controller}.{name}": axis.commanded_counts for name, axis in state.axes.items()}
    for axis, count in rest.counts.items():
        if abs(counts[axis] - count) > MAX_REST_COUNTS:
            text = f"axis {axis} is at {counts[axis]} counts; it was braked on its path at {count}"
            raise Refusal("other-start", text, "submit the job again", controller_of(axis))
    course = planned_step.path.course.restart(rest.path_s, counts)
    path = replace(planned_step.path, course=course)
    elapsed_ns = planned_step.elapsed_ns + rest.moved_ns
    planned_step = replace(
        planned_step, instances=instances, path=path, begun_s=rest.path_s, rate=rest.rate, elapsed_ns=elapsed_ns
    )
    return await _require_zones(services, planned_step, infos)


async def plan_following(services: MotionServices, request: StepRequest, before: PlannedStep) -> PlannedStep:
    """Plan a step from where `before`, which moves now, will leave its axes. Raises `Refusal`."""
    if before.resolved.overruns:
        raise Refusal("overrun", f"{', '.join(before.resolved.overruns)} comes back from its overrun before it")
    view = services.fleet.view
    states: dict[str, AxisState] = {}
    infos: dict[str, ControllerInfo] = {}
    instances: dict[str, str] = {}
    for controller in dict.fromkeys(map(controller_of, request.axes)):
        state = view.last_state(controller)
        if state is None or state.mode == "offline" or view.is_silent(controller):
            raise Refusal("offline", f"{controller} is offline or silent", "check its link", controller)
        infos[controller], instances[controller] = await view.infos.query(controller), state.instance
        states |= {f"{controller}.{axis}": axis_state for axis, axis_state in state.axes.items()}
    for axis, (_, counts) in before.ends.items():
        if axis in states:
            update = {"commanded_counts": counts, "play": before.plays.get(axis)}
            states[axis] = states[axis].model_copy(update=update)
    context = AxisContext(view.fleet, states, infos, services.targets.expect_targets(before.ends))
    planned_step = await _plan_from(services, request, context, {}, instances)
    if planned_step.resolved.take_ups:
        axes = ", ".join(move.axis for move in planned_step.resolved.take_ups)
        raise Refusal("take-up", f"{axes} takes up its play before it, at the speed of `backlash`")
    planned_step = await _require_zones(services, planned_step, infos, before)
    plays = {**before.plays, **planned_step.plays}
    return replace(planned_step, ends={**before.ends, **planned_step.ends}, plays=plays)


async def _plan_from(
    services: MotionServices,
    request: StepRequest,
    context: AxisContext,
    goal: Mapping[str, Fraction],
    instances: Mapping[str, str],
) -> PlannedStep:
    move = request.move
    require_whole_pairs(context.fleet, move)
    if move.triggers and goal:
        # Some of them have happened, and positions are counted from where the axis started.
        text = "a step with triggers cannot be continued after a feed hold"
        raise Refusal("triggers-held", text, "run the job again, from this step")
    triggers = resolve_triggers(context.fleet, move.triggers, lambda axis: context.states[axis].offset)
    services.fleet.permits.require(request.axes)
    try:
        if isinstance(move, FollowPath):
            starts = make_path_starts(move, context)
            plan_elsewhere = services.plan_long if find_long_paths([move]) else services.plan
            if isinstance(move, FlightPath):
                path, triggers = plan_flight_step(move, starts), place_triggers(move.part, triggers)
            elif isinstance(move, CurvedMove):
                path = await services.plan(plan_curved_move, move, starts, context.fleet)
            else:
                path = await plan_elsewhere(plan_path_step, move, starts, context.fleet.path_frames)
            resolved_move = ResolvedMove(path.moves, dict(path.exact), bounds=dict(path.bounds))
            return PlannedStep(request, resolved_move, path.plan, instances, path.exact, path=path, triggers=triggers)
        resolved_move = resolve_targets(move, context, goal)
        plan = plan_motion(context.fleet, move, resolved_move.moves)
    except PlanError as error:
        raise Refusal("plan", str(error)) from None
    exact, plays = resolved_move.exact, resolved_move.plays
    pairs = bound_pairs(context.fleet, plan, {name: info.alone_s for name, info in context.infos.items()})
    return PlannedStep(request, resolved_move, plan, instances, exact, plays, triggers=triggers, pairs=pairs)


async def _require_zones(
    services: MotionServices,
    planned: PlannedStep,
    infos: Mapping[str, ControllerInfo],
    before: PlannedStep | None = None,
) -> PlannedStep:
    """The step with where its axes may have stopped shortly before its end. before: the one that ends as it begins.
    Raises `Refusal` (code `zone`) where it may bring bodies together."""
    if services.fleet.view.fleet.zones is None:
        return planned
    request, path = planned.request, planned.path
    skew_ns = max(request.max_start_skew_ns, request.max_end_skew_ns or 0, request.max_path_skew_ns or 0)
    alone_times = {name: info.alone_s for name, info in infos.items()}
    if path is not None and path.course is not None and not planned.triggers:
        chunks = {name: info.chunk_s for name, info in infos.items() if info.chunk_s and max(info.orders) > 2}
        alone_times = bound_alone(alone_times, chunks)
    sweep = Sweep(
        planned.plan.profiles,
        {},
        Timing(alone_times, skew_ns / NS_PER_S),
        paths={} if path is None else find_path_terms(path),
        recent={} if before is None else before.recent,
        begin_s=planned.begun_s,
    )
    plan_elsewhere = services.plan_long if find_long_paths([request.move]) else services.plan
    ends, mover = None if before is None else before.ends, ZoneMover(request.job_id, request.index)
    return replace(planned, recent=await services.zones.require(sweep, mover, ends, plan_elsewhere))


async def _query_controller(
    view: FleetView, controller: str, seen_ns: int | None
) -> tuple[ControllerState, ControllerInfo]:
    try:
        state, info = await view.query_state(controller, seen_ns), await view.infos.query(controller)
    except BusError as error:
        raise view.make_absence(controller, str(error)) from None
    if state.mode == "offline":
        fault = state.faults[0] if state.faults else None
        raise Refusal(
            "offline",
            f"{controller} is offline: {fault.text if fault else 'no link'}",
            fault.remedy if fault else "check its link",
            controller,
        )
    for fault in state.faults:
        if fault.code == SETTING_CHANGED:  # it may have cost a reference, which would be refused without its cause
            raise Refusal(fault.code, f"{controller}: {fault.text}", fault.remedy, controller)
    return state, info
