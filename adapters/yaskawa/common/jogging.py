"""Axes moved by hand: PA to the end of the way at the jog's speed, or JG where there is no end.

FL and BL do not make an end: the axis slows down only after it has passed them (L5284), by its whole ramp. A position
absolute move ends exactly at its target by itself, and its speed may be changed while it moves (SP, L12844). Its
target and its deceleration may not (L4063, L8241), so that other changes go by way of a stop. Without an end the axis
jogs (JG, L12942), where everything may be changed on the fly, the direction too.
"""

import asyncio
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial

from adapters.contract import CannotDo, DriverFault, JogMove
from adapters.yaskawa.common.model import RAMP_UNIT, SPEED_UNIT
from adapters.yaskawa.common.record import AXIS_LETTERS, AxisRecord
from adapters.yaskawa.common.registers import exact_ramp, exact_speed
from adapters.yaskawa.smc4000.device import Device
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.clock.estimator import MAX_PPM

LOOK_NS = 5 * NS_PER_MS
REST_ROOM_NS = NS_PER_S  # beyond its ramp, for an axis to come to rest
FARTHEST = 2**31 - 1  # counts that one move can be long (L8210)


@dataclass(frozen=True, slots=True)
class _Run:
    """What an axis was last begun with, in registers. stops: how many it had been given by then."""

    sign: int
    speed: int
    ramp: int
    end: int | None
    stops: int

    def changes_into(self, other: "_Run") -> bool:
        """Whether the axis need not stand still in between."""
        if self.end is None:
            return other.end is None
        return (self.sign, self.ramp, self.end) == (other.sign, other.ramp, other.end)


class Jogging:
    """All jogs of one controller. motors: index by axis."""

    def __init__(self, device: Device, clock: Clock, motors: Mapping[str, int]) -> None:
        self._device = device
        self._clock = clock
        self._motors = motors
        self._runs: dict[int, _Run] = {}
        self._turns = {index: asyncio.Lock() for index in motors.values()}

    def forget(self, axes: Iterable[str]) -> None:
        """From now on `axes` move for another reason."""
        for axis in axes:
            self._runs.pop(self._motors[axis], None)

    async def jog(self, axis: str, move: JogMove) -> None:
        """Begin, or change to `move`. Raises `CannotDo`, also when a stop overtakes the call."""
        index = self._motors[axis]
        since = self._device.stops_given(index)
        async with self._turns[index]:
            self._device.require_no_stop(axis, index, since)
            wanted = self._in_registers(axis, move, since)
            async with self._device.together():
                now = await self._look(index)
                if not now.moving:
                    await self._begun(axis, index, wanted, now)
                    return
            held = self._runs.get(index)
            if held is None:
                raise CannotDo("moving", f"axis {axis} is moving", "wait, or stop it")
            if not await self._changed(axis, index, held, wanted, now):
                now = await self._brought_to_rest(axis, index, held)
                await self._begun(axis, index, wanted, now)

    def _in_registers(self, axis: str, move: JogMove, stops: int) -> _Run:
        samples = self._device.samples
        mapping = samples.mapping()
        tick_ns, unknown_ppm = (samples.tick_ns, MAX_PPM) if mapping is None else (mapping.tick_ns, mapping.drift_ppm)
        # Rather a little too slow than too fast, by what the crystal is not known.
        tick_s = tick_ns * (1 - unknown_ppm * 1e-6) * 1e-9
        return _Run(
            sign=1 if move.velocity_counts_s > 0 else -1,
            speed=exact_speed(axis, abs(move.velocity_counts_s), tick_s),
            ramp=exact_ramp(axis, move.ramp_counts_s2, tick_s),
            end=move.end_counts,
            stops=stops,
        )

    async def _look(self, index: int) -> AxisRecord:
        return (await self._device.record()).axes[index]

    async def _changed(self, axis: str, index: int, held: _Run, wanted: _Run, now: AxisRecord) -> bool:
        """Change the jog on the fly; False when it has to stand still first, or has just come to rest by itself."""
        if now.stopping or held.stops != wanted.stops or not held.changes_into(wanted):
            return False
        still = partial(self._device.require_no_stop, axis, index, wanted.stops)
        await self._device.session.tell_all(_change_commands(AXIS_LETTERS[index], held, wanted), still)
        self._runs[index] = wanted
        if self._device.stops_given(index) != wanted.stops:
            # The two may have crossed: nobody says that a speed given to a stopping axis does not set it going again.
            self._device.brake([index])
            self._device.require_no_stop(axis, index, wanted.stops)
        now = await self._look(index)
        return now.moving and not now.stopping

    async def _brought_to_rest(self, axis: str, index: int, held: _Run) -> AxisRecord:
        self._device.brake([index])
        ramp_samples = held.speed / SPEED_UNIT / (held.ramp / RAMP_UNIT)
        until_ns = self._clock.now_ns() + round(ramp_samples * self._device.samples.tick_ns) + REST_ROOM_NS
        while (now := await self._look(index)).moving:
            if self._clock.now_ns() > until_ns:
                raise DriverFault("not-stopping", f"axis {axis} does not stop", "stop it at the controller", axis)
            await sleep_ns(self._clock, LOOK_NS)
        return now

    async def _begun(self, axis: str, index: int, wanted: _Run, now: AxisRecord) -> None:
        if wanted.end is not None and wanted.sign * (wanted.end - now.commanded) <= 0:
            raise CannotDo(
                "at-end",
                f"axis {axis} stands at {now.commanded} counts; in this direction its way ends at {wanted.end}",
                "jog it the other way",
            )
        self._runs.pop(index, None)
        commands = _begin_commands(AXIS_LETTERS[index], wanted, now.commanded)
        async with self._device.together():
            still = partial(self._device.require_no_stop, axis, index, wanted.stops)
            await self._device.session.tell_all(commands, still)
            self._runs[index] = wanted
            await self._device.begin(axis, index, wanted.stops)


def _begin_commands(letter: str, run: _Run, start: int) -> tuple[str, ...]:
    ramps = (f"AC{letter}={run.ramp}", f"DC{letter}={run.ramp}")
    if run.end is None:
        return (*ramps, f"JG{letter}={run.sign * run.speed}")
    end = max(start - FARTHEST, min(start + FARTHEST, run.end))
    return (*ramps, f"SP{letter}={run.speed}", f"PA{letter}={end}")


def _change_commands(letter: str, held: _Run, wanted: _Run) -> tuple[str, ...]:
    if wanted.end is not None:
        return (f"SP{letter}={wanted.speed}",) if wanted.speed != held.speed else ()
    ramps = (f"AC{letter}={wanted.ramp}", f"DC{letter}={wanted.ramp}") if wanted.ramp != held.ramp else ()
    return (*ramps, f"JG{letter}={wanted.sign * wanted.speed}")
