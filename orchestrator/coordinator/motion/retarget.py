"""Other targets for the axes of a move that is under way: resolved, checked and planned before anything is changed."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.coordinator.motion.planning import StepRequest
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.targets import AxisContext, resolve_targets
from orchestrator.model.errors import Refusal
from orchestrator.model.names import controller_of
from orchestrator.model.state import AxisState, ControllerInfo
from orchestrator.model.steps.move import Move
from orchestrator.model.units import AxisQuantity, UnitError, parse_quantity
from orchestrator.plan.shape import PlanError
from orchestrator.plan.speeds import plan_motion


@dataclass(frozen=True, slots=True)
class AxisTargets:
    """Targets by axis: user positions (`to`), and distances from the targets that the axes have (`by`)."""

    to: Mapping[str, AxisQuantity]
    by: Mapping[str, AxisQuantity]


async def read_infos(services: MotionServices, move: Move) -> dict[str, ControllerInfo]:
    """What the controllers of a move can do. Raises `Refusal`."""
    view = services.fleet.view
    return {name: await view.require_info(name) for name in dict.fromkeys(map(controller_of, move.named_axes))}


def resolve_retarget(
    services: MotionServices,
    request: StepRequest,
    targets: AxisTargets,
    goal: Mapping[str, Fraction],
    infos: Mapping[str, ControllerInfo],
) -> dict[str, Fraction]:
    """The exact motor positions that `targets` stand for, checked and planned from where the axes are now. goal: the
    targets that they have. Raises `Refusal`."""
    view = services.fleet.view
    move = _require_move(request, targets)
    services.fleet.permits.require(request.axes)
    states: dict[str, AxisState] = {}
    for axis in request.axes:
        state = view.axis_now(axis)
        if state is None:
            controller = controller_of(axis)
            raise Refusal("offline", f"{controller} is offline or silent", "check its link", controller)
        states[axis] = state
    sums = {axis: _add(services, axis, distance, goal) for axis, distance in targets.by.items()}
    resolved = resolve_targets(move, AxisContext(view.fleet, states, infos, services.targets), sums)
    try:
        plan_motion(view.fleet, move, resolved.moves)
    except PlanError as error:
        raise Refusal("plan", str(error)) from None
    return {axis: exact for axis, (exact, _) in resolved.exact.items()}


def _require_move(request: StepRequest, targets: AxisTargets) -> Move:
    """The present move with other targets. Raises `Refusal` for what cannot have any."""
    move = request.move
    if not isinstance(move, Move):
        raise Refusal("not-a-move", "the present step follows a path", "wait for its end, or stop it")
    if move.triggers:
        # Their places are counted from where the axes started.
        raise Refusal("not-a-move", "outputs are switched on the way of the present move (`triggers`)", "stop it")
    axes, named = set(request.axes), [*targets.to, *targets.by]
    if set(named) != axes or len(named) != len(axes):
        text = f"the present move is one of {', '.join(sorted(axes))}, the targets are of {', '.join(named) or 'none'}"
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
