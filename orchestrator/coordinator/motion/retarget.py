"""Other targets for the axes of a move that is under way: resolved, checked and planned before anything is changed.

A single axis continues to them on the way if its controller follows positions of its computer, or can move farther. All
others brake together, and start again: controllers that change one by one would leave their common instants.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.motion.planning import StepRequest
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.step import PlannedMotion
from orchestrator.coordinator.motion.targets import AxisContext, ResolvedMove, resolve_targets
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import RetargetReply, RetargetRequest, raise_first_refusal
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.state import AxisState, ControllerInfo, RetargetAbility, RetargetWay
from orchestrator.model.steps.move import Move
from orchestrator.model.units import AxisQuantity, UnitError, parse_quantity
from orchestrator.model.zone_problems import list_zone_axes
from orchestrator.plan.retarget import continue_profile, extend_profile
from orchestrator.plan.shape import PlanError
from orchestrator.plan.speeds import limit_speeds, plan_motion
from orchestrator.plan.step import StepPlan


@dataclass(frozen=True, slots=True)
class AxisTargets:
    """Targets by axis: user positions (`to`), and distances from the targets that the axes have (`by`)."""

    to: Mapping[str, AxisQuantity]
    by: Mapping[str, AxisQuantity]


async def read_infos(services: MotionServices, axes: Iterable[str]) -> dict[str, ControllerInfo]:
    """What the controllers of axes can do. Raises `Refusal`."""
    view = services.fleet.view
    return {name: await view.infos.require(name) for name in dict.fromkeys(map(controller_of, axes))}


def resolve_retarget(
    services: MotionServices,
    request: StepRequest,
    targets: AxisTargets,
    goal: Mapping[str, Fraction],
    infos: Mapping[str, ControllerInfo],
) -> ResolvedMove:
    """The motor positions that `targets` stand for, checked and planned from where the axes are now. goal: the
    targets that they have. Raises `Refusal`."""
    view = services.fleet.view
    move = _require_move(request, targets)
    _require_no_zones(view.fleet, request.axes)
    services.fleet.permits.require(request.axes)
    states: dict[str, AxisState] = {}
    for axis in request.axes:
        state = view.axis_now(axis)
        if state is None:
            controller = controller_of(axis)
            raise Refusal("offline", f"{controller} is offline or silent", "check its link", controller)
        # A drive that brakes for the target before may state that it is not enabled meanwhile: the step looks again
        # once it is at rest.
        states[axis] = state.model_copy(update={"enabled": True})
    sums = {axis: _add(services, axis, distance, goal) for axis, distance in targets.by.items()}
    resolved_move = resolve_targets(move, AxisContext(view.fleet, states, infos, services.targets), sums)
    try:
        plan_motion(view.fleet, move, resolved_move.moves)
    except PlanError as error:
        raise Refusal("plan", str(error)) from None
    return resolved_move


def _require_no_zones(fleet: Fleet, axes: Sequence[str]) -> None:
    """Raise `Refusal` for axes on which rules of zones depend: the way from where they are on it is not checked."""
    zone_axes = () if fleet.zones is None else list_zone_axes(fleet.zones, fleet)
    bound_axes = [axis for axis in axes if axis in zone_axes]
    if bound_axes:
        text = (
            f"{', '.join(bound_axes)} moves bodies of zones, and other targets on the way are not checked against them"
        )
        raise Refusal("zone", text, "wait for the end of the move, or stop it, and move again")


def find_continuation(fleet: Fleet, infos: Mapping[str, ControllerInfo], axes: Sequence[str]) -> RetargetAbility | None:
    """How the only axis of a move continues to another target on the way; None: the axes brake. How much play is taken
    up by then is not known, so that an axis with play brakes."""
    if len(axes) != 1 or fleet.axis(axes[0]).backlash is not None:
        return None
    ability = infos[controller_of(axes[0])].retarget
    return None if ability is None or ability.way == "brake" else ability


async def continue_motion(
    services: MotionServices,
    motion: PlannedMotion,
    resolved_move: ResolvedMove,
    begin_fleet_ns: int,
    way: RetargetWay,
) -> PlannedMotion:
    """Have the only member of a moving step continue to other targets, from where its axis will be at an instant.
    Raises `Refusal`: it moves as before, or its answer was lost."""
    request, agreement, state = motion.planned.request, motion.agreement, motion.start.state
    if not agreement.plan.profiles:
        raise Refusal("late", "the axis does not move")
    (member,), (axis,) = agreement.members, agreement.plan.profiles
    from_s = (begin_fleet_ns - state.t0_fleet_ns) / NS_PER_S
    profile = agreement.plan.profiles[axis]
    assert isinstance(request.move, Move)
    if not state.decided or not 0.0 < from_s < profile.duration_s or member not in motion.watch.reports:
        raise Refusal("late", "the axis is not on its way then")
    try:
        (move,) = limit_speeds(services.fleet.view.fleet, request.move, resolved_move.moves)
        find_course = extend_profile if way == "extend" else continue_profile
        following = find_course(profile, from_s, move)
    except PlanError as error:
        raise Refusal("plan", str(error)) from None
    asked_request = RetargetRequest(
        **services.fleet.requests.request_fields(request.job.actor),
        job=request.job_id,
        step=request.index,
        t0_fleet_ns=state.t0_fleet_ns,
        from_s=from_s,
        profiles={split_name(axis)[1]: following},
    )
    replies = await services.fleet.requests.request_all("retarget", {member: asked_request}, RetargetReply)
    raise_first_refusal(replies)
    durations_s = replies[member].durations_s
    agreement.plan = StepPlan(following.duration_s, {axis: following}, agreement.plan.unmoved)
    changed_proposal = agreement.proposals[member].model_copy(update={"durations_s": durations_s})
    agreement.proposals[member] = changed_proposal
    motion.watch.extend(member, max(durations_s.values()))
    ends = {**motion.planned.ends, **resolved_move.exact}
    return replace(motion, planned=replace(motion.planned, resolved=resolved_move, plan=agreement.plan, ends=ends))


def _require_move(request: StepRequest, targets: AxisTargets) -> Move:
    """The present move with other targets. Raises `Refusal` for what cannot have any."""
    move = request.move
    if not isinstance(move, Move):
        raise Refusal("not-a-move", "the present step follows a path", "wait for its end, or stop it")
    if move.triggers:
        # Their places are counted from where the axes started.
        raise Refusal("not-a-move", "outputs are switched on the way of the present move (`triggers`)", "stop it")
    axes, named_axes = set(request.axes), [*targets.to, *targets.by]
    if set(named_axes) != axes or len(named_axes) != len(axes):
        target_axes = ", ".join(named_axes) or "none"
        text = f"the present move is one of {', '.join(sorted(axes))}, the targets are of {target_axes}"
        raise Refusal("other-axes", text, "name one target for each axis of the move")
    return move.model_copy(update={"to": dict(targets.to), "by": dict(targets.by)})


def _add(services: MotionServices, axis: str, distance: AxisQuantity, goal: Mapping[str, Fraction]) -> Fraction:
    if axis not in goal:
        text = f"the target of {axis} is not planned yet, so that nothing can be added to it"
        raise Refusal("not-moving", text, "name the position (`to`), or wait until the job runs")
    try:
        return goal[axis] + parse_quantity(distance, services.fleet.view.fleet.axis(axis).unit)
    except UnitError as error:
        raise Refusal("bad-unit", f"{axis}: {error}", controller=controller_of(axis)) from None
