"""Alarms of controllers and axes, by the states and events that they publish anyway."""

from collections import deque
from collections.abc import Collection
from typing import NamedTuple

from orchestrator.clock.base import Clock
from orchestrator.coordinator.alarms.conditions import AlarmConditions
from orchestrator.coordinator.fleet.view import SLOW_REMEDY, FleetView
from orchestrator.model.names import controller_of
from orchestrator.model.numbers import format_ns
from orchestrator.model.operation.alarms import MAX_SUBJECT, AlarmCause, AlarmRecord
from orchestrator.model.operation.pair_state import observe_pair
from orchestrator.model.state import ControllerEvent, ControllerState, FaultReport

MAX_FAULTS = 20  # of one controller that count
MAX_CODE = 60
KINDS = (
    *("disconnected", "fault", "limit-switch", "racked", "zone"),
    *("clock-bound", "link-errors", "following-error", "budget"),
)
_STARTING = "starting"  # an adapter that has not reached its controller yet


class _Signature(NamedTuple):
    """What of a state can raise an alarm; a state with the same signature as before needs no more attention."""

    offline: bool
    faults: tuple[tuple[str, str | None], ...]
    estop: str | None
    limits: tuple[str, ...]
    wide_clock: bool


class FleetAlarms:
    """Reports the conditions of controllers. Nothing is asked of them."""

    def __init__(self, view: FleetView, conditions: AlarmConditions, clock: Clock) -> None:
        self._view = view
        self._conditions = conditions
        self._clock = clock
        self._seen: dict[str, _Signature] = {}
        self._limits: dict[str, str] = {}
        """By axis: the limit switch that it is on; only where it was not searching for its reference."""
        self._estops: dict[str, str] = {}
        """By controller that is latched: what latched it, in words."""
        self._breaks: dict[str, deque[int]] = {}

    def names(self, record: AlarmRecord) -> bool:
        """Whether the subject of an alarm is in the fleet file; so is that of one of no controller."""
        fleet, parts = self._view.fleet, record.subject.split("+")
        return record.kind not in KINDS or all(
            fleet.has_axis(part) if "." in part else part in fleet.controllers for part in parts
        )

    def take_state(self, state: ControllerState) -> None:
        """Compare a state with the one before; a listener of the view."""
        controller = state.controller
        self._report_racked(controller)
        bound_ns = 0 if state.clock is None else state.clock.bound_ns
        axes = state.axes.items()
        signature = _Signature(
            state.mode == "offline",
            tuple((fault.code, fault.axis) for fault in state.faults[:MAX_FAULTS]),
            None if state.estop is None else state.estop.event,
            tuple(f"{name} {axis.limit} {axis.homing}" for name, axis in axes if axis.limit != "none" or axis.homing),
            bound_ns > self._view.fleet.alarms.clock_bound.limit,
        )
        signature_before = self._seen.get(controller)
        if signature == signature_before:
            return
        self._seen[controller] = signature
        self._report_connection(controller, state.faults, absent=signature.offline)
        self._report_faults(controller, state.faults, known=not signature.offline)
        self._report_estop(state)
        if not signature.offline:
            self._report_limits(state)
            self._report_clock(controller, bound_ns, wide=signature.wide_clock)

    def take_event(self, event: ControllerEvent) -> None:
        """Count breaks of links; a listener of the view."""
        if event.kind == "offline" and event.controller in self._view.fleet.controllers:
            self._breaks.setdefault(event.controller, deque(maxlen=100_000)).append(self._clock.now_ns())
            self._report_breaks(event.controller)

    def tick(self) -> None:
        """Look at what no message announces: silence, and time that passes."""
        for controller in self._view.fleet.controllers:
            if self._view.is_silent(controller):
                # Its next state counts as new, whatever it is.
                self._seen.pop(controller, None)
                self._report_connection(controller, [], absent=True)
        for controller in list(self._breaks):
            self._report_breaks(controller)

    def _report_connection(self, controller: str, faults: list[FaultReport], *, absent: bool) -> None:
        reason, remedy = "its adapter is silent", "see `tutti status`; is its adapter host running?"
        if faults:
            reason, remedy = faults[0].text, faults[0].remedy
        elif (slow_start := self._view.describe_slow_start(controller)) is not None:
            reason, remedy = slow_start, SLOW_REMEDY
        text = f"{controller} is offline: {reason}"
        action = remedy or "check power and cable of the controller"
        self._conditions.report(AlarmCause("disconnected", controller, text, action), holds=absent)

    def _report_faults(self, controller: str, faults: list[FaultReport], *, known: bool) -> None:
        """One alarm for each code. known: what is not among `faults` is over; of a controller that is offline it is
        not known."""
        reported_ids: set[str] = set()
        for fault in faults[:MAX_FAULTS]:
            if fault.code == _STARTING:
                continue
            subject = controller if fault.axis is None else f"{controller}.{fault.axis}"
            action = fault.remedy or "see `tutti status`"
            cause = AlarmCause(
                "fault", subject[:MAX_SUBJECT], f"{controller}: {fault.text}", action, fault.code[:MAX_CODE]
            )
            reported_ids.add(cause.id)
            self._conditions.report(cause, holds=True)
        for cause in self._conditions.find_all("fault", controller) if known else ():
            if cause.id not in reported_ids:
                self._conditions.report(cause, holds=False)

    def _report_estop(self, state: ControllerState) -> None:
        """One alarm for the fleet: an e-stop has one cause, however many controllers it stops."""
        latch = state.estop
        if latch is None:
            self._estops.pop(state.controller, None)
        else:
            self._estops[state.controller] = latch.describe()
        other_controllers = self._view.fleet.controllers.keys() - self._seen.keys()
        if not self._estops and not all(map(self._view.is_silent, other_controllers)):
            return  # after a start, one that is not seen yet may be latched
        text = next(iter(self._estops.values()), "")
        action = "find the reason, make the machine safe, then `tutti reset`"
        self._conditions.report(AlarmCause("estop", "fleet", text, action), holds=bool(self._estops))

    def _report_limits(self, state: ControllerState) -> None:
        for name, axis in state.axes.items():
            full, on = f"{state.controller}.{name}", axis.limit != "none"
            is_new = on and full not in self._limits
            if is_new:
                # An axis that searches for its reference may reach its limit switch.
                self._limits[full] = "" if axis.homing or not axis.referenced else axis.limit
            elif not on:
                self._limits.pop(full, None)
            text = f"{full} is on its {axis.limit} limit switch"
            name_whole = self._view.fleet.virtual_axes.name_whole(full)
            action = f"jog it back: `tutti axis jog {name_whole}`; check its soft limits and its reference"
            self._conditions.report(AlarmCause("limit-switch", full, text, action), holds=bool(self._limits.get(full)))

    def _report_racked(self, controller: str) -> None:
        """Of the pairs of a controller, also at rest."""
        fleet = self._view.fleet
        for pair in fleet.virtual_axes.find_pairs(controller):
            members = [controller_of(axis) for axis in pair.real]
            states = {name: state for name in members if (state := self._view.last_state(name)) is not None}
            observed_pair = observe_pair(fleet, pair, states)
            if observed_pair is not None:
                text = pair.describe_rack(observed_pair.deviation)
                cause = AlarmCause("racked", "+".join(pair.real), text, pair.square_remedy)
                self._conditions.report(cause, holds=observed_pair.is_racked)

    def _report_clock(self, controller: str, bound_ns: int, *, wide: bool) -> None:
        text = f"the clock of {controller} is known to {format_ns(bound_ns)} only"
        action = f"see `tutti clock show {controller}`; check its link, and the load of its adapter host"
        self._conditions.report(AlarmCause("clock-bound", controller, text, action), holds=wide)

    def _report_breaks(self, controller: str) -> None:
        rule, breaks = self._view.fleet.alarms.link_errors, self._breaks[controller]
        while breaks and breaks[0] < self._clock.now_ns() - rule.within:
            breaks.popleft()
        text = f"the link of {controller} has broken {len(breaks)} times within {format_ns(rule.within)}"
        cause = AlarmCause("link-errors", controller, text, "check its cable, plugs and shielding")
        self._conditions.report(cause, holds=len(breaks) >= rule.limit)
        if not breaks:
            del self._breaks[controller]


def is_of_axes(record: AlarmRecord | AlarmCause, axes: Collection[str]) -> bool:
    """Whether an alarm concerns one of `axes`, or the controller of one."""
    controllers = {controller_of(axis) for axis in axes}
    return record.kind in KINDS and any(part in axes or part in controllers for part in record.subject.split("+"))
