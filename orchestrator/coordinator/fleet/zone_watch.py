"""The watch on keep-out zones: axes are stopped before bodies come nearer than they may, whatever moves them."""

from dataclasses import dataclass, field, replace
from typing import Protocol

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.operation.alarms import MAX_SUBJECT, AlarmCause
from orchestrator.model.state import AxisState, ControllerState
from orchestrator.plan.zones.memory import ZoneMemory
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.plan.zones.search import RuleCheck
from orchestrator.plan.zones.watch import AxisSight, Danger, find_closing_speed, look_at_rule

STOP_S = 0.2
"""From the arrival of a state until a stop that follows from it takes effect: messages, and the commands of a stop."""
OLD_S = 1.0
"""A position that was read longer ago is not known any more, nor one that was not read in three polls at rest."""
OVERSPEED = 1.5
"""An axis may be faster than its limit by this factor: an override, or a controller that is set otherwise."""
LONGEST_NS = NS_PER_S  # between two looks at a rule
AGAIN_NS = NS_PER_S  # after which axes that still move are stopped again
REMEDY = "jog them apart: `tutti axis jog`; see `tutti zones show`"


class ReportAlarm(Protocol):
    """Reports a condition that raises an alarm, or that it is over."""

    def __call__(self, cause: AlarmCause, *, holds: bool) -> None: ...


class ZoneWatch:
    """Looks at the rules of zones with every state of one of their controllers that arrives.

    What a job moves, homes or jogs was checked ahead, and is stopped where a rule is surely broken. What moves
    otherwise, by another client or by hand, is stopped before a rule may be broken: with how far it may have moved
    since it was read, until the next reading and until a stop takes effect, and by its ramp. An axis that goes offline
    or loses its reference while others move counts as anywhere in its range from then on.
    """

    def __init__(self, access: FleetAccess, memory: ZoneMemory, report: ReportAlarm) -> None:
        self._access = access
        self._view = access.view
        self._memory = memory
        self._report = report
        self._fleet: Fleet | None = None
        self._zones: FleetZones | None = None
        self._rules: dict[str, list[_WatchedRule]] = {}
        self._axes: dict[str, list[str]] = {}
        self._sights: dict[str, AxisSight] = {}
        access.view.add_state_listener(self.take_state)

    def take_state(self, state: ControllerState) -> None:
        """Look at the rules that depend on a controller."""
        fleet = self._view.fleet
        if fleet is not self._fleet:
            self._begin(fleet)
        zones = self._zones
        if zones is None or state.controller not in self._rules:
            return
        for controller, names in self._axes.items():
            if controller == state.controller:
                for name in names:
                    self._note(name, self._see(fleet.axis(name), name, state))
            elif self._view.is_silent(controller):
                for name in names:
                    self._note(name, AxisSight(None, moving=False, cause="silent"))
        now_ns = self._access.clock.now_ns()
        for rule in self._rules[state.controller]:
            if now_ns >= rule.free_until_ns:
                self._look(rule, zones, now_ns)

    def _note(self, axis: str, sight: AxisSight) -> None:
        """Keep what is seen of an axis; where its position is lost or found, its rules are looked at again at once."""
        last_sight = self._sights[axis]
        self._sights[axis] = sight
        if (sight.position is None, sight.unchecked) != (last_sight.position is None, last_sight.unchecked):
            for rule in self._rules[controller_of(axis)]:
                rule.free_until_ns = 0

    def _begin(self, fleet: Fleet) -> None:
        """Begin anew with a fleet file."""
        self._fleet, self._zones = fleet, None if fleet.zones is None else self._memory.read(fleet)
        self._rules, self._axes, self._sights = {}, {}, {}
        if self._zones is None:
            return
        self._sights = dict.fromkeys(self._zones.ranges, AxisSight(None, moving=False, cause="offline"))
        for name in dict.fromkeys(axis for check in self._zones.rules for axis in check.constraint.axes):
            self._axes.setdefault(controller_of(name), []).append(name)
        speeds = {name: OVERSPEED * fleet.axis(name).limits.velocity for name in self._zones.ranges}
        for check in self._zones.rules:
            rule = _WatchedRule(check, find_closing_speed(check.constraint, self._zones.ranges, speeds))
            for controller in dict.fromkeys(map(controller_of, check.constraint.axes)):
                self._rules.setdefault(controller, []).append(rule)

    def _look(self, rule: "_WatchedRule", zones: FleetZones, now_ns: int) -> None:
        constraint = rule.check.constraint
        sights = {axis: self._sights[axis] for axis in constraint.axes}
        if any(sight.moving for sight in sights.values()):
            # What moves was checked with where these stood before.
            rule.lost = {axis for axis, sight in sights.items() if rule.is_lost(axis, sight)}
            for axis in rule.lost:
                sights[axis] = replace(sights[axis], unchecked=True)
        else:
            rule.lost = set()
        rule.known = {axis for axis, sight in sights.items() if sight.position is not None}
        rule_sight = look_at_rule(constraint, sights, zones.ranges, trust_step=rule.check.trust_step)
        rule.free_until_ns = now_ns + rule.find_free_ns(rule_sight.free)
        danger = rule_sight.danger
        text = "" if danger is None else f"zone {rule.check.name}: {danger.text}"
        cause = AlarmCause("zone", "+".join(constraint.axes)[:MAX_SUBJECT], text, REMEDY)
        self._report(cause, holds=danger is not None and danger.broken)
        if danger is not None and danger.moving and not self._is_leaving(danger):
            self._stop(rule, danger, text, now_ns)

    def _is_leaving(self, danger: Danger) -> bool:
        """Whether all that moves is jogged, which is checked with each of its frames: it may leave."""
        states = [self._view.last_state(controller_of(axis)) for axis in danger.moving]
        return all(state is not None and state.mode == "jogging" for state in states)

    def _see(self, axis: Axis, name: str, state: ControllerState) -> AxisSight:
        local = split_name(name)[1]
        if state.mode == "offline" or local not in state.axes:
            return AxisSight(None, moving=False, cause="offline")
        age_s = self._find_age_s(state)
        if age_s > max(OLD_S, 3.0 / self._view.fleet.controllers[state.controller].state.idle_hz):
            return AxisSight(None, moving=False, cause=f"not read for {age_s:.1f} s")
        axis_state, is_unchecked = state.axes[local], _is_unplanned(state, local)
        if not axis_state.referenced:
            cause = "homing" if axis_state.homing else "not referenced"
            return AxisSight(None, axis_state.moving, is_unchecked, cause=cause)
        if not axis_state.moving:
            return AxisSight(axis_state.motor_position, moving=False, unchecked=is_unchecked)
        reach, drift = self._find_reach(axis, axis_state, state), abs(axis_state.velocity) * self._find_wait_s(state)
        return AxisSight(axis_state.motor_position, axis_state.moving, is_unchecked, reach, drift)

    def _find_age_s(self, state: ControllerState) -> float:
        """How long ago its positions were read at most, s, with the way of the state to here; 0 where it does not
        say."""
        if state.read_within is None:
            return 0.0
        now_ns = self._access.requests.leadership.fleet_now_ns()
        return max(now_ns - state.read_within.earliest_ns, 0) / NS_PER_S

    def _find_wait_s(self, state: ControllerState) -> float:
        """From when a controller that moves was read until it is read again, s."""
        return self._find_age_s(state) + 1.0 / self._view.fleet.controllers[state.controller].state.moving_hz

    def _find_reach(self, axis: Axis, axis_state: AxisState, state: ControllerState) -> float:
        """How far an axis that moves may come until it stands, in its unit."""
        speed = max(axis.limits.velocity, abs(axis_state.velocity))
        return speed * (self._find_wait_s(state) + STOP_S) + speed**2 / (2 * axis.limits.acceleration)

    def _stop(self, rule: "_WatchedRule", danger: Danger, text: str, now_ns: int) -> None:
        if rule.stopped_ns is not None and now_ns < rule.stopped_ns + AGAIN_NS:
            return
        rule.stopped_ns = now_ns
        controllers = list(dict.fromkeys(map(controller_of, danger.moving)))
        self._access.log.warning(f"{text}: {', '.join(controllers)} is stopped; {REMEDY}")
        stop = self._access.stop_members(controllers, "decelerate", "coordinator", text)
        self._access.tasks.spawn(stop, vital=False)


@dataclass(slots=True)
class _WatchedRule:
    """A rule, and what was found of it last. closing_speed: of its bodies at most, mm/s. free_until_ns: until when it
    cannot be broken, unless what is known of its axes changes. known: its axes whose positions are known; lost: those
    that have been lost while others moved."""

    check: RuleCheck
    closing_speed: float
    free_until_ns: int = 0
    known: set[str] = field(default_factory=set[str])
    lost: set[str] = field(default_factory=set[str])
    stopped_ns: int | None = None

    def find_free_ns(self, free: float) -> int:
        """For how long its bodies cannot approach each other by `free`, mm."""
        if free <= 0.0:
            return 0
        return LONGEST_NS if not self.closing_speed else min(round(free / self.closing_speed * NS_PER_S), LONGEST_NS)

    def is_lost(self, axis: str, sight: AxisSight) -> bool:
        """Whether the position of an axis is lost, and was not so when the motion beside it began."""
        return sight.position is None and sight.cause != "homing" and (axis in self.known or axis in self.lost)


def _is_unplanned(state: ControllerState, axis: str) -> bool:
    """Whether an axis moves although the fleet does not move it: no step, no lease on it, no homing, jog or stop."""
    is_ours = state.job is not None or axis in state.leases or state.mode in ("homing", "jogging", "stopping")
    return state.axes[axis].moving and not is_ours
