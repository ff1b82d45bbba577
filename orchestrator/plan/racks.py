"""How far the two motors of axes may be apart on a planned way, and whether that fits `may_rack`."""

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.report import RackBound
from orchestrator.plan.step import StepPlan

ROUNDED_DOWN = 0.995  # three digits of a speed are not above it


def require_single_motor(name: str, axis: Axis, verb: str) -> None:
    """Raise `Refusal` for an axis of two motors. verb: what it is wanted for."""
    if axis.rack is not None:
        text = f"axis {name} has two motors, and moves from rest to rest only"
        raise Refusal("two-motors", text, f"{verb} with another axis", controller_of(name))


def bound_racks(fleet: Fleet, plan: StepPlan) -> dict[str, RackBound]:
    """The bound of each axis of two motors that a plan moves: a stop brakes with the ramps of its profile."""
    bounds: dict[str, RackBound] = {}
    for name, profile in plan.profiles.items():
        axis = fleet.axis(name)
        if axis.rack is None or profile.is_still:
            continue
        scale = float(axis.scale)
        speed, ramp = profile.peak_velocity / scale, profile.peak_acceleration / scale
        most = axis.rack.at_speed(speed, ramp)
        bounds[name] = RackBound(most=most, watched=axis.rack.watched, speed=speed, unit=axis.unit)
    return bounds


def require_racks(fleet: Fleet, plan: StepPlan) -> None:
    """Raise `Refusal` for a plan after whose faults two motors may be farther apart than `may_rack`."""
    for name, bound in bound_racks(fleet, plan).items():
        axis = fleet.axis(name)
        assert axis.rack is not None
        if bound.most > axis.rack.most:
            ramp = plan.profiles[name].peak_acceleration / float(axis.scale)
            text = (
                f"at {bound.speed:.4g} {axis.unit}/s the motors of axis {name} may be {bound.most:.4g} {axis.unit} "
                f"apart after a fault; its `may_rack` is {axis.rack.most:g}"
            )
            fitting = ROUNDED_DOWN * axis.rack.fastest(ramp)
            remedy = f"move it at {fitting:.3g} {axis.unit}/s or less (`speed`), or lower its limit"
            if ramp < ROUNDED_DOWN * axis.limits.acceleration:
                remedy += f"; its ramps are gentler here than its limit, {axis.limits.acceleration:g} (see `ramps`)"
            raise Refusal("may-rack", text, remedy)
