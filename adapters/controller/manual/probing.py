"""Probes: an axis moves until an input changes. Checked here for all makes; its controller stops it, or its host."""

from adapters.abilities import LimitProbeDriver, ProbeDriver
from adapters.contract import AxisReading, ControllerReading, LimitMove, ProbedContact, ProbeMove
from adapters.controller.manual.host_probe import HostProbe
from adapters.controller.monitoring.polling import StatePolling
from adapters.controller.monitoring.settling import SettlingMonitor
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import NOT_REFERENCED, Refusal
from orchestrator.model.fleet import MAX_COUNTS, Axis, DigitalInput
from orchestrator.model.messages import ProbeReply, ProbeRequest
from orchestrator.model.state import PROBE_BY_HOST, ProbeAbility

SPEED_TOLERANCE = 1e-9  # tolerance for a speed that was rounded in transit
OVERTRAVEL_TOLERANCE = 1e-6


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
        self._host = HostProbe(context, status, polling)
        self._config = context.config
        self._status = status
        self._polling = polling
        self._settling = settling

    async def probe(self, request: ProbeRequest) -> ProbeReply:
        """Move an axis until an input changes, and answer when it is at rest. Raises `Refusal`."""
        name, status = request.axes[0], self._status
        point = None if request.input is None else self._find_point(request.input)
        status.require_no_fault()
        status.require_enabled([name])
        status.probing.add(name)
        try:
            return await self._run(name, point, request)
        finally:
            status.probing.discard(name)

    async def _run(self, name: str, point: DigitalInput | None, request: ProbeRequest) -> ProbeReply:
        status, stopped_ns = self._status, self._status.stopped_ns
        # The checks are of this moment: before it, the axis or the input may have been changed by another client.
        await self._polling.poll_and_publish()
        move = self._make_move(name, point, request)
        start_counts = status.require_online().axes[name].actual_counts
        if status.stopped_ns != stopped_ns:
            raise Refusal("stopped", "the controller was stopped before the probe began", "probe again")
        contact = await self._probe_axis(name, move, request)
        # A drive may report motion for a while after it has come to rest; where it rests is read then.
        rest_ns = self._context.driver.capabilities.costs.stop_ns + NS_PER_S
        if not await self._settling.wait_for_rest([name], rest_ns):
            raise Refusal("probe-broken", f"axis {name} has not come to rest", "stop it, and see what moves it")
        reading = status.require_online()
        rest_counts = reading.axes[name].actual_counts
        if contact is None:
            return ProbeReply(start_counts=start_counts, rest_counts=rest_counts)
        scale = self._context.require_scale()
        earliest_ns, latest_ns = scale.to_fleet_span(contact.span.earliest_ns, contact.span.latest_ns)
        return ProbeReply(
            touched=True,
            least_counts=contact.least,
            most_counts=contact.most,
            earliest_ns=earliest_ns,
            latest_ns=latest_ns,
            start_counts=start_counts,
            rest_counts=rest_counts,
            released=_is_released(name, move, request, reading),
        )

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
        level = "active" if move.active else "passive"
        return self._driver.probe_ability.find_way(name, move.point.number, level)

    def _find_point(self, name: str) -> DigitalInput:
        point = self._config.inputs.get(name)
        if point is None:
            input_names = ", ".join(self._config.inputs) or "none"
            raise Refusal("unknown-input", f"no input {name}; inputs: {input_names}", "correct the name")
        return point

    def _make_move(self, name: str, point: DigitalInput | None, request: ProbeRequest) -> LimitMove:
        """The move for the driver after all checks. Raises `Refusal`."""
        axis, reading = self._config.axes[name], self._status.require_online()
        axis_reading, limits = reading.axes[name], axis.limits
        if not self._status.referenced[name]:
            remedy = f"home it first: a step `do: home` for {name}"
            raise Refusal(NOT_REFERENCED, f"axis {name} is not referenced", remedy)
        if any(other_reading.moving for other_reading in reading.axes.values()):
            raise Refusal("moving", "an axis of the controller is moving", "wait for its end, or stop it")
        if request.speed > limits.velocity * (1 + SPEED_TOLERANCE):
            text = f"axis {name}: {request.speed:g} {axis.unit}/s exceeds its limit of {limits.velocity:g}"
            raise Refusal("velocity-limit", text, "probe more slowly")
        sign = 1 if request.end_counts >= axis_reading.commanded_counts else -1
        self._require_room(name, axis, request.end_counts, sign * request.overtravel_counts)
        _require_direction(name, axis_reading, request, "forward" if sign > 0 else "reverse")
        scale = float(axis.scale)
        move = LimitMove(request.end_counts, request.speed * scale, limits.acceleration * scale)
        if point is not None:
            move = ProbeMove(
                move.end_counts, move.speed_counts_s, move.ramp_counts_s2, point=point, active=request.active
            )
        self._require_bound(name, axis, move, request)
        if isinstance(move, ProbeMove) and reading.inputs.get(move.point.number) != (not move.level):
            word = "active" if request.active else "passive"
            text = f"input {request.input} is {word} already"
            raise Refusal("line-level", text, "move the axis away from the contact first, or check the input's wire")
        return move

    def _require_room(self, name: str, axis: Axis, end: int, overtravel: float) -> None:
        """Raise `Refusal` unless the end of the probe, and what the axis may go on there, are inside its range."""
        low, high = axis.soft_limits_counts or (-MAX_COUNTS, MAX_COUNTS - 1)
        if not (low <= end <= high and low <= end + overtravel <= high):
            text = (
                f"axis {name}: the probe ends at {axis.to_unit(end):g} {axis.unit}, and a contact there ends it at "
                f"{axis.to_unit(end + overtravel):g}; soft limits are {axis.to_unit(low):g} to {axis.to_unit(high):g}"
            )
            raise Refusal("soft-limit", text, "end the probe earlier, probe more slowly, or change the soft limits")

    def _require_bound(self, name: str, axis: Axis, move: LimitMove, request: ProbeRequest) -> None:
        """Raise `Refusal` where what stops the axis has a longer overtravel than the request states."""
        ability = self._host.ability if request.by == "host" else self._find_way(name, move)
        if ability is None:
            return
        most = ability.find_overtravel(move.speed_counts_s, move.ramp_counts_s2)
        if most > request.overtravel_counts * (1 + OVERTRAVEL_TOLERANCE):
            text = f"axis {name} goes on by at most {abs(axis.to_length(most)):g} {axis.unit} behind a contact"
            raise Refusal("overtravel", f"{text}, which is more than was stated", "run the job again")


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
