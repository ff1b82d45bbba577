"""Probes: axes move until an input changes. Checked here for all makes; their controller stops them, or its host."""

from collections.abc import Mapping, Sequence
from typing import Literal

from adapters.abilities import LimitProbeDriver, LineProbeDriver, ProbeDriver
from adapters.contract import AxisReading, ControllerReading, LimitMove, ProbedContact, ProbeMove
from adapters.controller.manual.host_probe import HostProbe
from adapters.controller.monitoring.polling import StatePolling
from adapters.controller.monitoring.settling import SettlingMonitor
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import NOT_REFERENCED, Refusal
from orchestrator.model.fleet import MAX_COUNTS, Axis, DigitalInput
from orchestrator.model.messages import ProbedAxis, ProbeReply, ProbeRequest, ProbeTerms
from orchestrator.model.state import PROBE_BY_HOST, ProbeAbility
from orchestrator.model.steps.probe import find_line_ramps

SPEED_TOLERANCE = 1e-9  # tolerance for a speed that was rounded in transit
OVERTRAVEL_TOLERANCE = 1e-6
STAND_COUNTS = 1.0  # by which the position of an axis that stands is off


class AxisProbing:
    """The probes of one controller."""

    def __init__(
        self,
        context: ControllerContext,
        status: ControllerStatus,
        polling: StatePolling,
        settling: SettlingMonitor,
    ) -> None:
        self._context = context
        self._driver = context.driver if isinstance(context.driver, ProbeDriver) else None
        self._limits = context.driver if isinstance(context.driver, LimitProbeDriver) else None
        self._lines = context.driver if isinstance(context.driver, LineProbeDriver) else None
        self._host = HostProbe(context, status, polling)
        self._config = context.config
        self._status = status
        self._polling = polling
        self._settling = settling

    async def probe(self, request: ProbeRequest) -> ProbeReply:
        """Move axes until an input changes, and answer when they are at rest. Raises `Refusal`."""
        status = self._status
        point = None if request.input is None else self._find_point(request.input)
        status.require_no_fault()
        status.require_enabled(request.axes)
        status.probing.update(request.axes)
        try:
            return await self._run(point, request)
        finally:
            status.probing.difference_update(request.axes)

    async def _run(self, point: DigitalInput | None, request: ProbeRequest) -> ProbeReply:
        status, stopped_ns, names = self._status, self._status.stopped_ns, request.axes
        # The checks are of this moment: before it, the axes or the input may have been changed by another client.
        await self._polling.poll_and_publish()
        moves = self._make_moves(point, request)
        starts = {name: reading.actual_counts for name, reading in status.require_online().axes.items()}
        if status.stopped_ns != stopped_ns:
            raise Refusal("stopped", "the controller was stopped before the probe began", "probe again")
        contacts = await self._probe_axes(moves, request)
        # A drive may report motion for a while after it has come to rest; where it rests is read then.
        rest_ns = self._context.driver.capabilities.costs.stop_ns + NS_PER_S
        if not await self._settling.wait_for_rest(names, rest_ns):
            text = f"axis {' or '.join(names)} has not come to rest"
            raise Refusal("probe-broken", text, "stop it, and see what moves it")
        probed_axes, reading = self._join_contacts(names, starts, contacts), status.require_online()
        first_axis = probed_axes.pop(names[0])
        reply = ProbeReply(**dict(first_axis), line=probed_axes)
        if contacts is None:
            return reply
        span = next(iter(contacts.values())).span
        earliest_ns, latest_ns = self._context.require_scale().to_fleet_span(span.earliest_ns, span.latest_ns)
        is_released = _is_released(names[0], moves[names[0]], request, reading)
        update = {"touched": True, "earliest_ns": earliest_ns, "latest_ns": latest_ns, "released": is_released}
        return reply.model_copy(update=update)

    def _join_contacts(
        self, names: Sequence[str], starts: Mapping[str, float], contacts: Mapping[str, ProbedContact] | None
    ) -> dict[str, ProbedAxis]:
        """What is known of each axis at rest. contacts: of those that moved; one that stood was where it is."""
        reading, probed_axes = self._status.require_online(), dict[str, ProbedAxis]()
        for name in names:
            rest_counts = reading.axes[name].actual_counts
            probed_axes[name] = ProbedAxis(start_counts=starts[name], rest_counts=rest_counts)
            if contacts is not None:
                contact = contacts.get(name)
                least, most = (
                    (rest_counts - STAND_COUNTS, rest_counts + STAND_COUNTS)
                    if contact is None
                    else (contact.least, contact.most)
                )
                probed_axes[name] = probed_axes[name].model_copy(update={"least_counts": least, "most_counts": most})
        return probed_axes

    async def _probe_axes(
        self, moves: Mapping[str, LimitMove], request: ProbeRequest
    ) -> Mapping[str, ProbedContact] | None:
        """Move the axes that go somewhere; None: they are at rest at their ends, and nothing was touched."""
        line = self._list_line(moves)
        if len(line) <= 1:
            name = next(iter(line), request.axes[0])
            contact = await self._probe_axis(name, moves[name], request)
            return None if contact is None else {name: contact}
        if self._lines is None or self._find_line_way(line) is None:
            text = f"axes {' and '.join(line)}: this make cannot stop them on a line by that input"
            raise Refusal("no-probe", text, "probe with one axis at a time")
        return await self._lines.probe_line(line)

    def _list_line(self, moves: Mapping[str, LimitMove]) -> dict[str, ProbeMove]:
        """The axes that go somewhere."""
        reading = self._status.require_online()
        return {
            name: move
            for name, move in moves.items()
            if isinstance(move, ProbeMove) and move.end_counts != reading.axes[name].commanded_counts
        }

    async def _probe_axis(self, name: str, move: LimitMove, request: ProbeRequest) -> ProbedContact | None:
        if not isinstance(move, ProbeMove):
            if self._limits is None or self._limits.limit_ability is None:
                text = f"axis {name}: this make does not state how its limit switches stop an axis"
                raise Refusal("no-probe", text, "probe until an input changes")
            return await self._limits.probe_limit(name, move)
        if request.by == "host":
            return await self._host.probe_axis(name, move)
        if self._driver is None or self._find_way(name, move) is None:
            text = f"axis {name}: this make cannot stop it by input {move.point.number}"
            raise Refusal("no-probe", text, PROBE_BY_HOST)
        return await self._driver.probe_axis(name, move)

    def _find_way(self, name: str, move: LimitMove) -> ProbeAbility | None:
        """What stops an axis by its controller; None: nothing does."""
        if not isinstance(move, ProbeMove):
            return self._limits and self._limits.limit_ability
        if self._driver is None:
            return None
        return self._driver.probe_ability.find_way(name, move.point.number, _name_level(move))

    def _find_line_way(self, line: Mapping[str, ProbeMove]) -> ProbeAbility | None:
        """What stops the axes of a line by its controller; None: nothing does."""
        ability = None if self._lines is None else self._lines.line_ability
        ways = [ability and ability.find_way(name, move.point.number, _name_level(move)) for name, move in line.items()]
        return None if None in ways else ability

    def _find_point(self, name: str) -> DigitalInput:
        point = self._config.inputs.get(name)
        if point is None:
            input_names = ", ".join(self._config.inputs) or "none"
            raise Refusal("unknown-input", f"no input {name}; inputs: {input_names}", "correct the name")
        return point

    def _make_moves(self, point: DigitalInput | None, request: ProbeRequest) -> dict[str, LimitMove]:
        """The moves for the driver after all checks. Raises `Refusal`."""
        reading, terms = self._status.require_online(), request.terms
        if any(axis_reading.moving for axis_reading in reading.axes.values()):
            raise Refusal("moving", "an axis of the controller is moving", "wait for its end, or stop it")
        axes = {name: self._config.axes[name] for name in request.axes}
        ramps = find_line_ramps(axes, {name: terms[name].speed for name in axes})
        moves = {name: self._make_move(name, point, request, terms[name], ramps[name]) for name in axes}
        line = self._list_line(moves)
        for name, move in moves.items():
            ability = self._find_line_way(line) if len(line) > 1 else self._find_ability(name, move, request)
            _require_bound(name, axes[name], move, terms[name], ability)
        move = moves[request.axes[0]]
        if isinstance(move, ProbeMove) and reading.inputs.get(move.point.number) != (not move.level):
            text = f"input {request.input} is {_name_level(move)} already"
            raise Refusal("line-level", text, "move the axis away from the contact first, or check the input's wire")
        return moves

    def _make_move(
        self, name: str, point: DigitalInput | None, request: ProbeRequest, terms: ProbeTerms, ramp: float
    ) -> LimitMove:
        """The move of an axis. ramp: in its unit/s². Raises `Refusal`."""
        axis, axis_reading = self._config.axes[name], self._status.require_online().axes[name]
        if not self._status.referenced[name]:
            remedy = f"home it first: a step `do: home` for {name}"
            raise Refusal(NOT_REFERENCED, f"axis {name} is not referenced", remedy)
        if terms.speed > axis.limits.velocity * (1 + SPEED_TOLERANCE):
            text = f"axis {name}: {terms.speed:g} {axis.unit}/s exceeds its limit of {axis.limits.velocity:g}"
            raise Refusal("velocity-limit", text, "probe more slowly")
        sign = 1 if terms.end_counts >= axis_reading.commanded_counts else -1
        self._require_room(name, axis, terms.end_counts, sign * terms.overtravel_counts)
        _require_direction(name, axis_reading, request, "forward" if sign > 0 else "reverse")
        speed, ramp_counts_s2 = terms.speed * float(axis.scale), ramp * float(axis.scale)
        if point is None:
            return LimitMove(terms.end_counts, speed, ramp_counts_s2)
        return ProbeMove(terms.end_counts, speed, ramp_counts_s2, point=point, active=request.active)

    def _find_ability(self, name: str, move: LimitMove, request: ProbeRequest) -> ProbeAbility | None:
        """What stops an axis that moves alone."""
        return self._host.ability if request.by == "host" else self._find_way(name, move)

    def _require_room(self, name: str, axis: Axis, end: int, overtravel: float) -> None:
        """Raise `Refusal` unless the end of the probe, and what the axis may go on there, are inside its range."""
        low, high = axis.soft_limits_counts or (-MAX_COUNTS, MAX_COUNTS - 1)
        if not (low <= end <= high and low <= end + overtravel <= high):
            text = (
                f"axis {name}: the probe ends at {axis.to_unit(end):g} {axis.unit}, and a contact there ends it at "
                f"{axis.to_unit(end + overtravel):g}; soft limits are {axis.to_unit(low):g} to {axis.to_unit(high):g}"
            )
            raise Refusal("soft-limit", text, "end the probe earlier, probe more slowly, or change the soft limits")


def _require_bound(name: str, axis: Axis, move: LimitMove, terms: ProbeTerms, ability: ProbeAbility | None) -> None:
    """Raise `Refusal` where what stops the axis has a longer overtravel than the request states."""
    if ability is None:
        return
    most = ability.find_overtravel(move.speed_counts_s, move.ramp_counts_s2)
    if most > terms.overtravel_counts * (1 + OVERTRAVEL_TOLERANCE):
        text = f"axis {name} goes on by at most {abs(axis.to_length(most)):g} {axis.unit} behind a contact"
        raise Refusal("overtravel", f"{text}, which is more than was stated", "run the job again")


def _name_level(move: ProbeMove) -> Literal["active", "passive"]:
    return "active" if move.active else "passive"


def _require_direction(name: str, reading: AxisReading, request: ProbeRequest, direction: str) -> None:
    """Raise `Refusal` for an axis that is on the limit switch of this direction, or is to find that of the other."""
    limit = "none" if reading.limit_inferred else reading.limit
    if limit in ("both", direction):
        raise Refusal("limit-switch", f"axis {name} is on its {limit} limit switch", "probe in the other direction")
    if request.limit not in (None, direction):
        text = f"axis {name} moves away from its {request.limit} limit switch"
        raise Refusal("probe-input", text, "name the other one: directions are those of the controller's counts")


def _is_released(name: str, move: LimitMove, request: ProbeRequest, reading: ControllerReading) -> bool:
    """Whether what has stopped the axis has changed back since."""
    if isinstance(move, ProbeMove):
        return reading.inputs.get(move.point.number) == (not move.level)
    return reading.axes[name].limit not in (request.limit, "both")
