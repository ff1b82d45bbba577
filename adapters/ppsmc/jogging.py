"""Axes moved by hand: an absolute move to the end of the way, with the jog's speed and ramp.

`fast`, `run` and `spin` end nowhere but at a limit switch, and are not taken while another axis moves. `goto` is
(L2003), ends exactly at its target, and has the ramps of acc and dec. But speeds can be set only while the whole unit
is idle: a jog that needs others than are loaded brings all jogging axes to rest for a moment, and sends them on.
"""

import asyncio
from contextlib import suppress
from dataclasses import dataclass, replace
from math import floor

from adapters.contract import CannotDo, DriverFault, JogMove
from adapters.ppsmc import fleetaxes, loading
from adapters.ppsmc.moves import Mover
from adapters.ppsmc.replies import ASK_SETTINGS, Bits, settings
from adapters.ppsmc.trapezoid import POSITION_MAX, Bounds
from adapters.ppsmc.unitstate import Look, UnitState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.model.fleet import Controller

_LOOK_NS = 5 * NS_PER_MS
_REST_ROOM_NS = NS_PER_S  # beyond its ramp, for an axis to come to rest
_LAG_NS = 500 * NS_PER_MS  # ready bits may lag behind a start
_ANOTHER = -1  # no number of stops: a run that is over
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class _Run:
    """What an axis was last set going with. profile: as in `loading.PROFILE`. stops: how many it had been given."""

    axis: str
    motor: int
    sign: int
    profile: tuple[int, int, int, int]
    end: int
    stops: int

    @property
    def ramp_ns(self) -> int:
        s, f, _, d = self.profile
        return round((f - s) / (1000.0 * d) * NS_PER_S)


class Jogging:
    """All jogs of one connection."""

    def __init__(self, config: Controller, clock: Clock, unit: UnitState, mover: Mover) -> None:
        self._config = config
        self._clock = clock
        self._unit = unit
        self._mover = mover
        self._runs: dict[int, _Run] = {}
        self._turn = asyncio.Lock()

    async def jog(self, axis: str, move: JogMove) -> None:
        """Begin, or change to `move`. Raises `CannotDo`, also when a stop overtakes the call."""
        unit, motor = self._unit, fleetaxes.motor(self._config.axes[axis])
        since = unit.stops_given(motor)
        async with self._turn, unit.loading:
            unit.require_enabled([axis])
            unit.require_no_stop(axis, motor, since)
            if self._mover.move is not None:
                raise CannotDo("busy", "a move is loaded or under way", "disarm or stop it")
            wanted = _lowered(axis, motor, move, fleetaxes.bounds(self._config.axes[axis]), since)
            look = await self._look()
            held = self._going(motor, look)
            if not look.ready(motor) and held is None:
                raise CannotDo("moving", f"axis {axis} is moving", "wait, or stop it")
            if held == wanted:
                return
            onward: list[_Run] = []
            if unit.profiles.get(motor) == wanted.profile:
                if held is not None:
                    look = await self._brought_to_rest([held])
            else:
                onward = [run for other in self._runs if other != motor and (run := self._going(other, look))]
                look = await self._brought_to_rest([*onward, *([held] if held is not None else [])])
                await self._load(wanted, look)
            self._require_way(wanted, look)
            await self._go(wanted, look)
            for run in onward:
                # Stopped meanwhile, or at its end already: it stays where it is.
                with suppress(CannotDo):
                    unit.require_no_stop(run.axis, run.motor, run.stops)
                    self._require_way(run, look)
                    await self._go(run, look)

    async def _look(self) -> Look:
        look = await self._unit.look()
        if look.blocked:
            raise CannotDo("blocked", "the controller is blocked", "release it with `tutti reset`")
        if look.program:
            raise CannotDo("busy", "a program runs in the controller", "wait for its end, or stop it")
        return look

    def _going(self, motor: int, look: Look) -> _Run | None:
        """What an axis was set going with here, as long as it moves by that and was not stopped."""
        run = self._runs.get(motor)
        if run is None or look.ready(motor) or motor not in self._unit.by_hand:
            return None
        return run

    async def _brought_to_rest(self, runs: list[_Run]) -> Look:
        for run in runs:
            self._runs[run.motor] = replace(run, stops=_ANOTHER)
        if runs:
            self._unit.brake(run.motor for run in runs)
        until_ns = self._clock.now_ns() + max((run.ramp_ns for run in runs), default=0) + _REST_ROOM_NS
        look = await self._look()
        while moving := [run.axis for run in runs if not look.ready(run.motor)]:
            if self._clock.now_ns() > until_ns:
                raise DriverFault("not-stopping", f"axis {moving[0]} does not stop", "stop it at the unit", moving[0])
            await sleep_ns(self._clock, _LOOK_NS)
            look = await self._look()
        return look

    async def _load(self, wanted: _Run, look: Look) -> None:
        """Speeds, read back: a garbled digit would make it too fast."""
        if not look.idle:
            raise CannotDo("moving", "another axis of the controller moves", "wait, or stop it")
        lines = [f"{n}{wanted.motor}:{v}" for n, v in zip(loading.PROFILE, wanted.profile, strict=True)]
        held = settings((await self._unit.session.say(lines, ASK_SETTINGS)).lines(ASK_SETTINGS))
        self._unit.profiles.pop(wanted.motor, None)
        loading.require_profile(wanted.axis, wanted.motor, wanted.profile, held)
        self._unit.profiles[wanted.motor] = wanted.profile

    def _require_way(self, wanted: _Run, look: Look) -> None:
        counts, bits = look.counts[wanted.motor], look.bits[wanted.motor]
        if counts is None or wanted.sign * (wanted.end - counts) <= 0:
            raise CannotDo(
                "at-end",
                f"axis {wanted.axis} stands at {counts} steps; in this direction its way ends at {wanted.end}",
                "jog it the other way",
            )
        if bits & (Bits.LIMIT_FORWARD if wanted.sign > 0 else Bits.LIMIT_REVERSE):
            raise CannotDo("limit", f"axis {wanted.axis} is on its limit switch", "jog it the other way")

    async def _go(self, wanted: _Run, look: Look) -> None:
        unit, before = self._unit, look.counts[wanted.motor]
        self._runs[wanted.motor] = wanted
        unit.by_hand.add(wanted.motor)
        target = fleetaxes.written(wanted.end, unit.gears[wanted.motor])
        await unit.set_going(f"goto{wanted.motor}:{target}", wanted.axis, wanted.motor, wanted.stops)
        until_ns = self._clock.now_ns() + _LAG_NS
        while (now := await self._look()).ready(wanted.motor) and now.counts[wanted.motor] == before:
            unit.require_no_stop(wanted.axis, wanted.motor, wanted.stops)
            if self._clock.now_ns() > until_ns:
                unit.brake([wanted.motor])
                raise CannotDo(
                    "not-started",
                    f"axis {wanted.axis} does not move after `goto{wanted.motor}:{target}`",
                    "look at `emips` and for messages on the unit's screen",
                )
            await sleep_ns(self._clock, _LOOK_NS)


def _lowered(axis: str, motor: int, move: JogMove, limits: Bounds, stops: int) -> _Run:
    """Whole numbers that do not go beyond `move`."""
    asked = abs(move.velocity_counts_s)
    f = floor(min(asked, limits.speed) * (1 + _ROUNDING))
    if f < max(1, limits.start_min):
        raise CannotDo(
            "too-slow", f"axis {axis}: {asked:g} steps/s is slower than it can go", f"at least {limits.start_min}"
        )
    s = min(f, max(1, limits.start_min))
    ramp = min(1000, floor(move.ramp_counts_s2 / 1000 * (1 + _ROUNDING)))
    if ramp < 1:
        # Gentler than the unit's slowest ramp: only at a speed that needs none.
        s = f = min(f, limits.start_max)
        ramp = 1
    sign = 1 if move.velocity_counts_s > 0 else -1
    # The counter itself ends there (L2022).
    end = sign * POSITION_MAX if move.end_counts is None else max(-POSITION_MAX, min(POSITION_MAX, move.end_counts))
    return _Run(axis, motor, sign, (s, f, ramp, ramp), end, stops)
