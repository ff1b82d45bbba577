"""Jogging: PA to the end position at the jog's speed, or JG where there is no end position.

FL and BL cannot serve as the end: the axis begins to decelerate only after it has passed them (L5284), and overruns by
its whole ramp. A position-absolute move ends exactly at its target, and its speed may be changed while it moves (SP,
L12844). Its target and its deceleration may not (L4063, L8241), so that other changes require a stop. Without an end
position the axis jogs (JG, L12942), where everything may be changed on the fly, including the direction.
"""

import asyncio
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial

from adapters.contract import JogMove
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.registers import exact_ramp, exact_speed
from adapters.yaskawa.shapes.model import RAMP_UNIT, SPEED_UNIT
from adapters.yaskawa.wire.record import AXIS_LETTERS, AxisRecord
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.clock.estimator import MAX_PPM
from orchestrator.model.errors import ControllerFault, Refusal

POLL_NS = 5 * NS_PER_MS
REST_MARGIN_NS = NS_PER_S  # beyond its ramp, for an axis to come to rest
LONGEST_MOVE = 2**31 - 1  # counts, the longest single move (L8210)


@dataclass(frozen=True, slots=True)
class _JogRun:
    """The registers with which an axis was last started. stops: its number of stops at that time."""

    sign: int
    speed: int
    ramp: int
    end: int | None
    stops: int

    def can_change_to(self, other: "_JogRun") -> bool:
        """Return whether the change is possible without a standstill."""
        if self.end is None:
            return other.end is None
        return (self.sign, self.ramp, self.end) == (other.sign, other.ramp, other.end)


class YaskawaJogging:
    """All jogs of one controller. motors: index by axis."""

    def __init__(self, device: SmcDevice, clock: Clock, motors: Mapping[str, int]) -> None:
        self._device = device
        self._clock = clock
        self._motors = motors
        self._runs: dict[int, _JogRun] = {}
        self._turns = {index: asyncio.Lock() for index in motors.values()}

    def drop_jogs(self, axes: Iterable[str]) -> None:
        """Drop the jogs of `axes`: they now move for another reason."""
        for axis in axes:
            self._runs.pop(self._motors[axis], None)

    async def start_jog(self, axis: str, move: JogMove) -> None:
        """Begin a jog, or change to `move`. Raises `Refusal`, also when a stop overtakes the call."""
        index = self._motors[axis]
        stop_count = self._device.stop_counts.stop_count(index)
        async with self._turns[index]:
            self._device.stop_counts.require_no_stop(axis, index, stop_count)
            wanted_run = self._in_registers(axis, move, stop_count)
            async with self._device.exclusive_turn():
                state = await self._read_axis(index)
                if not state.is_moving:
                    await self._begin_jog(axis, index, wanted_run, state)
                    return
            held_run = self._runs.get(index)
            if held_run is None:
                raise Refusal("moving", f"axis {axis} is moving", "wait for its end, or stop it")
            if not await self._change_running(axis, index, held_run, wanted_run, state):
                state = await self._bring_to_rest(axis, index, held_run)
                await self._begin_jog(axis, index, wanted_run, state)

    def _in_registers(self, axis: str, move: JogMove, stops: int) -> _JogRun:
        samples = self._device.samples
        mapping = samples.current_mapping()
        tick_ns, unknown_ppm = (samples.tick_ns, MAX_PPM) if mapping is None else (mapping.tick_ns, mapping.drift_ppm)
        # Rather a little too slow than too fast, by the uncertainty of the crystal.
        tick_s = tick_ns * (1 - unknown_ppm * 1e-6) * 1e-9
        return _JogRun(
            sign=1 if move.velocity_counts_s > 0 else -1,
            speed=exact_speed(axis, abs(move.velocity_counts_s), tick_s),
            ramp=exact_ramp(axis, move.ramp_counts_s2, tick_s),
            end=move.end_counts,
            stops=stops,
        )

    async def _read_axis(self, index: int) -> AxisRecord:
        return (await self._device.read_record()).axes[index]

    async def _change_running(self, axis: str, index: int, held: _JogRun, wanted: _JogRun, now: AxisRecord) -> bool:
        """Change the jog on the fly; return False when the axis must stand still first, or has just come to rest by
        itself."""
        if now.is_stopping or held.stops != wanted.stops or not held.can_change_to(wanted):
            return False
        check = partial(self._device.stop_counts.require_no_stop, axis, index, wanted.stops)
        await self._device.session.send_settings(_change_commands(AXIS_LETTERS[index], held, wanted), check)
        self._runs[index] = wanted
        if self._device.stop_counts.stop_count(index) != wanted.stops:
            # Both commands may have crossed: the manual does not exclude that a speed given to a stopping axis restarts
            # it.
            self._device.brake_axes([index])
            self._device.stop_counts.require_no_stop(axis, index, wanted.stops)
        now = await self._read_axis(index)
        return now.is_moving and not now.is_stopping

    async def _bring_to_rest(self, axis: str, index: int, held: _JogRun) -> AxisRecord:
        self._device.brake_axes([index])
        ramp_samples = held.speed / SPEED_UNIT / (held.ramp / RAMP_UNIT)
        until_ns = self._clock.now_ns() + round(ramp_samples * self._device.samples.tick_ns) + REST_MARGIN_NS
        while (state := await self._read_axis(index)).is_moving:
            if self._clock.now_ns() > until_ns:
                raise ControllerFault("not-stopping", f"axis {axis} does not stop", "stop it at the controller", axis)
            await sleep_ns(self._clock, POLL_NS)
        return state

    async def _begin_jog(self, axis: str, index: int, wanted: _JogRun, now: AxisRecord) -> None:
        if wanted.end is not None and wanted.sign * (wanted.end - now.commanded) <= 0:
            raise Refusal(
                "at-end",
                f"axis {axis} is at {now.commanded} counts; its range in this direction ends at {wanted.end}",
                "jog in the other direction",
            )
        self._runs.pop(index, None)
        commands = _begin_commands(AXIS_LETTERS[index], wanted, now.commanded)
        async with self._device.exclusive_turn():
            check = partial(self._device.stop_counts.require_no_stop, axis, index, wanted.stops)
            await self._device.session.send_settings(commands, check)
            self._runs[index] = wanted
            await self._device.begin_motion(axis, index, wanted.stops)


def _begin_commands(letter: str, run: _JogRun, start: int) -> tuple[str, ...]:
    ramps = (f"AC{letter}={run.ramp}", f"DC{letter}={run.ramp}")
    if run.end is None:
        return (*ramps, f"JG{letter}={run.sign * run.speed}")
    end = max(start - LONGEST_MOVE, min(start + LONGEST_MOVE, run.end))
    return (*ramps, f"SP{letter}={run.speed}", f"PA{letter}={end}")


def _change_commands(letter: str, held: _JogRun, wanted: _JogRun) -> tuple[str, ...]:
    if wanted.end is not None:
        return (f"SP{letter}={wanted.speed}",) if wanted.speed != held.speed else ()
    ramps = (f"AC{letter}={wanted.ramp}", f"DC{letter}={wanted.ramp}") if wanted.ramp != held.ramp else ()
    return (*ramps, f"JG{letter}={wanted.sign * wanted.speed}")
