"""Jogs of a controller with text lines."""

from collections.abc import Callable, Mapping, Sequence

from adapters.contract import JogMove
from adapters.toolkit.lines.dialect import LineDialect, LineTarget
from adapters.toolkit.lines.lowering import CountScale, axis_acceleration
from adapters.toolkit.lines.unit import LineUnit, LineUnitState
from adapters.toolkit.stop_counter import send_or_brake
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller

_JOG_AHEAD_S = 600.0  # a jog without an end goes this far; it is stopped long before
_POLL_NS = 20 * NS_PER_MS
_REST_NS = 2 * NS_PER_S


class LineJogging:
    """The jogs of one controller, which outlive its connections. scales: by axis."""

    def __init__(self, config: Controller, dialect: LineDialect, scales: Mapping[str, CountScale]) -> None:
        self._config = config
        self._dialect = dialect
        self._scales = scales
        self._ramp_s = max(axis.limits.velocity / axis.limits.acceleration for axis in config.axes.values())
        self._jogs: dict[str, JogMove] = {}

    async def jog_axis(self, unit: LineUnit, axis: str, move: JogMove, stop_count: int) -> None:
        """Begin a jog, or continue one with another speed. stop_count: at the time of the request. Raises
        `Refusal`, `ControllerFault`."""
        await unit.wait_until_tidy()
        state = await unit.read_state()
        motor = self._config.axes[axis].motors[0]
        if state.status.state != "moving":
            self._jogs.clear()
        joint = self._dialect.traits.joint
        if state.status.state == "moving" and joint and axis not in self._jogs:
            raise Refusal("busy", "another axis moves; this controller jogs one at a time", "stop it first")
        if state.status.state == "moving" and state.status.axes[motor].moving:
            if self._jogs.get(axis) == move:
                return
            unit.session.write_at_once(self._dialect.stop_jog(motor))
            state = await self._wait_for_rest(unit, motor)
        if axis not in unit.enabled:
            raise Refusal("not-enabled", f"axis {axis} is not enabled", f"enable {axis} first")
        await unit.number_again()
        if state.status.state in ("held", "alarm") or await unit.is_restarted(state):
            raise Refusal("not-ready", f"the controller is {state.status.state}", "see `tutti status`")
        target = self._make_jog_target(axis, move, state.counts[axis])
        (first, *later_steps) = self._dialect.begin_jog(target)

        async def send(check: Callable[[], None]) -> None:
            await unit.session.run_once(first, check)
            await unit.session.run_procedure(later_steps)

        await send_or_brake(
            send,
            lambda: unit.require_no_stop(stop_count),
            lambda: unit.session.write_at_once(self._dialect.stop_jog(motor)),
        )
        self._jogs[axis] = move

    def stop_axes(self, unit: LineUnit, axes: Sequence[str]) -> None:
        """Stop the jogs of these axes by their ramps."""
        for name in axes:
            self._jogs.pop(name, None)
            unit.session.write_at_once(self._dialect.stop_jog(self._config.axes[name].motors[0]))
        unit.stops += bool(axes)

    async def _wait_for_rest(self, unit: LineUnit, motor: str) -> LineUnitState:
        """Wait until a jog that was stopped has come to rest. Raises `ControllerFault`."""
        limit_ns = unit.clock.now_ns() + round(self._ramp_s * NS_PER_S) + _REST_NS
        while True:
            state = await unit.read_state()
            if state.status.state != "moving" or not state.status.axes[motor].moving:
                return state
            if unit.clock.now_ns() > limit_ns:
                raise ControllerFault("not-stopping", f"{motor} does not stop", "stop it at the controller")
            await sleep_ns(unit.clock, _POLL_NS)

    def _make_jog_target(self, axis: str, move: JogMove, here: int) -> LineTarget:
        """Return the target of a jog. Raises `Refusal`."""
        scale, config = self._scales[axis], self._config.axes[axis]
        end = move.end_counts
        if end is None:
            end = here + round(move.velocity_counts_s * _JOG_AHEAD_S)
        if (end - here) * move.velocity_counts_s <= 0:
            raise Refusal("at-end", f"axis {axis} is at {here}; its range in this direction ends at {end}", "jog back")
        ramp = axis_acceleration(config) if self._dialect.traits.fixed_acceleration else move.ramp_counts_s2
        return LineTarget(
            config.motors[0],
            scale.to_position(end),
            (end - here) / scale.counts_per_unit,
            abs(move.velocity_counts_s) / scale.counts_per_unit,
            ramp / scale.counts_per_unit,
        )
