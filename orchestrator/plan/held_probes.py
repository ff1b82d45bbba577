"""Probes whose axes the coordinator stops: how late it does at most, and what that makes of their way and their line.

The coordinator sees the input in the states of its controller. Between the contact and the ramps are, one after the
other: the input itself; the time to the reading that shows it, at the rate of the fleet file; that reading and its way
to the coordinator; the request to stop; and what each controller has between that and its ramp, by the time of a stop
that it states. The first three are enforced: a probe whose input was not read for that long is stopped.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.state import HOST_RAMP_SHARE, INPUT_S, ProbeAbility
from orchestrator.model.steps.probe import Probe
from orchestrator.plan.probes import ProbeAbilities

READ_S = 0.1
"""A reading and its way to the coordinator; beyond the period of the readings."""
NEIGHBOUR_S = 0.08
"""Added for each other controller on the line of the input's one: up to four exchanges of 25 ms on the slowest."""
IDLE_SPREAD = 1.08
"""The period of the readings at rest is up to this longer than the fleet file says."""
MESSAGE_S = 0.05
"""From the coordinator to an adapter host, as long as the bus works."""
START_SKEW_NS = 20_000_000
"""How far apart the axes of such a probe may start."""
LAG_S = 0.005
"""An axis is behind its command by the way of this time at most."""
LINE_COUNTS = 2.0
"""By which an axis is off its line beside times: rounding of its plan and of its ramp."""
PATH_S = 0.05
"""What a controller executes may be off the plan by the way of this time, and `LINE_COUNTS`; a probe does not begin
where it is more."""


@dataclass(frozen=True, slots=True)
class HeldTimes:
    """The times of a probe whose axes the coordinator stops, s. watch_s: from the beginning of a reading to the request
    to stop that it causes, or that its successor would have. leads_s: by controller, from that request to the ramp."""

    watch_s: float
    leads_s: Mapping[str, float]

    @property
    def spread_s(self) -> float:
        """Within this time all controllers begin to brake."""
        return MESSAGE_S + max(self.leads_s.values())

    def make_ability(self, ramp_s: float, *, is_line: bool) -> ProbeAbility:
        """What that is for each axis. ramp_s: the longest ramp of the probe, in full."""
        skew_s = START_SKEW_NS / 1e9
        # Ramps that are not alike, each at least a share of the planned one, end half their difference apart.
        apart_s = skew_s + PATH_S + self.spread_s + ramp_s * (1 / HOST_RAMP_SHARE - 1) / 2
        return ProbeAbility(
            inputs={},
            levels=["active", "passive"],
            reaction_s=self.watch_s + self.spread_s,
            ramp_share=HOST_RAMP_SHARE,
            margin_counts=2 * LINE_COUNTS + 1,
            contact_s=INPUT_S + LAG_S + PATH_S + skew_s,
            contact_counts=LINE_COUNTS,
            line_s=apart_s if is_line else 0.0,
            line_counts=2 * LINE_COUNTS if is_line else 0.0,
        )


def find_watch_s(fleet: Fleet, step: Probe) -> float:
    """The longest time from the beginning of a reading of the input to the request to stop, s. Its controller is read
    as often as the fleet file says; also of a member, all axes may stand, or come to rest before those of others."""
    config = fleet.controllers[controller_of(step.until)]
    period_s = max(1 / config.state.moving_hz, IDLE_SPREAD / config.state.idle_hz)
    neighbours = sum(other_config.line == config.line for other_config in fleet.controllers.values()) - 1
    return period_s + READ_S + NEIGHBOUR_S * neighbours


def find_held_times(fleet: Fleet, step: Probe, abilities: Mapping[str, ProbeAbilities]) -> HeldTimes:
    """The times of a held probe. abilities: of the controllers of its axes. Raises `Refusal` for one whose stop has no
    bound, or that does not show the input while it moves."""
    controller, members = controller_of(step.until), list(dict.fromkeys(map(controller_of, step.axes)))
    if controller in members and not abilities[controller].shows_inputs:
        text = f"{step.until}: the make {abilities[controller].make} does not show its inputs while it moves"
        remedy = "connect the signal to a controller that rests, or of another make"
        raise Refusal("no-probe", text, remedy, controller)
    leads_s: dict[str, float] = {}
    for member in members:
        ability = abilities[member]
        leads_s[member] = ability.costs.find_stop_lead_s(fleet.controllers[member].full_ramps_s)
        if not leads_s[member]:
            text = f"{member}: a stop takes at most {ability.costs.stop_ns / 1e9:g} s as the make {ability.make} states"
            text = f"{text}, and the ramp alone longer: how late it brakes is not known"
            remedy = "give its axes a higher `acceleration` in the fleet file, as far as they can; or probe without it"
            raise Refusal("no-probe", text, remedy, member)
    return HeldTimes(find_watch_s(fleet, step), leads_s)


def find_ways_to_stop(
    fleet: Fleet,
    step: Probe,
    axes: Mapping[str, Axis],
    abilities: Mapping[str, ProbeAbilities],
    most_speeds: Mapping[str, float],
) -> dict[str, ProbeAbility]:
    """What stops each axis of a probe. abilities: by controller. most_speeds: in the units of the axes. Raises
    `Refusal`."""
    if not step.is_held:
        return {name: abilities[controller_of(name)].require_ability(fleet, step, name) for name in axes}
    ramp_s = max(most_speeds[name] / axis.limits.acceleration for name, axis in axes.items())
    ability = find_held_times(fleet, step, abilities).make_ability(ramp_s, is_line=step.is_line)
    return dict.fromkeys(axes, ability)
