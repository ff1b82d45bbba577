"""Axes moved by hand: an absolute move to the end of the way, with the jog's speed and ramp.

The unit's own jog (J:, L4859) is of no use for it: it runs at the minimum speed S without ramps, changes speed at once
(JD:, L5132), and ends nowhere but at a limit sensor. `A:` ends exactly at its target by itself, with ramps, and sends
no completion line (L4774). D: and A: are refused while the axis is busy (L4937, L3247), so that every change goes by
way of a stop. Nothing of it gets into the prebuffers, and arming a step deletes what it leaves in the execution buffer.
"""

import asyncio
from contextlib import suppress
from dataclasses import dataclass, replace
from math import ceil, floor

from adapters.contract import CannotDo, DriverFault, JogMove
from adapters.shrc203 import fleetaxes
from adapters.shrc203.moves import Mover
from adapters.shrc203.replies import READY, STATUS, AxisStatus, amounts, entries, status, triples
from adapters.shrc203.status import ERRORS, why_stopped
from adapters.shrc203.trapezoid import DISTANCE_MAX, RAMP_MAX_MS, SPEED_MAX, Bounds
from adapters.shrc203.unitstate import UnitState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import Controller

_LOOK_NS = 5 * NS_PER_MS
_REST_ROOM_NS = NS_PER_S  # beyond its ramp, for an axis to come to rest
_ANOTHER = -1  # no number of stops: a run that is over
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class _Run:
    """What an axis was last set going with, pls/s and ms. stops: how many it had been given by then."""

    sign: int
    s: int
    f: int
    r: int
    end: int
    stops: int

    @property
    def speeds(self) -> str:
        return f"S{self.s}F{self.f}R{self.r}"


class Jogging:
    """All jogs of one connection."""

    def __init__(self, config: Controller, clock: Clock, unit: UnitState, mover: Mover) -> None:
        self._config = config
        self._clock = clock
        self._unit = unit
        self._mover = mover
        self._runs: dict[int, _Run] = {}
        self._turns = {motor: asyncio.Lock() for motor in fleetaxes.motors(config).values()}

    async def jog(self, axis: str, move: JogMove) -> None:
        """Begin, or change to `move`. Raises `CannotDo`, also when a stop overtakes the call."""
        unit, motor = self._unit, fleetaxes.motor(self._config.axes[axis])
        since = unit.stops_given(motor)
        async with self._turns[motor]:
            unit.require_no_stop(axis, motor, since)
            wanted = _lowered(axis, move, fleetaxes.bounds(self._config.axes[axis]), since)
            await self._mover.tidy()
            now = await self._look(motor)
            if now.busy:
                held = self._runs.get(motor)
                if held is None or motor not in unit.by_hand:
                    raise CannotDo("moving", f"axis {axis} is moving", "wait, or stop it")
                if held == wanted:
                    return
                now = await self._brought_to_rest(axis, motor, held)
            await self._begun(axis, motor, wanted, now)

    async def _look(self, motor: int) -> AxisStatus:
        return status(await self._unit.session.ask("Q:SPC", STATUS), self._unit.controllable)[motor]

    async def _brought_to_rest(self, axis: str, motor: int, held: _Run) -> AxisStatus:
        self._runs[motor] = replace(held, stops=_ANOTHER)
        self._unit.brake([motor])
        until_ns = self._clock.now_ns() + held.r * NS_PER_MS + _REST_ROOM_NS
        while await self._unit.session.ask(f"!:{motor}S", READY) == "B":
            if self._clock.now_ns() > until_ns:
                raise DriverFault("not-stopping", f"axis {axis} does not stop", "stop it at the unit", axis)
            await sleep_ns(self._clock, _LOOK_NS)
        return await self._look(motor)

    async def _begun(self, axis: str, motor: int, wanted: _Run, now: AxisStatus) -> None:
        if now.word & ERRORS:
            raise CannotDo("fault", why_stopped(axis, now), "clear it with `tutti reset`")
        if wanted.sign * (wanted.end - now.counts) <= 0:
            raise CannotDo(
                "at-end",
                f"axis {axis} stands at {now.counts} pulses; in this direction its way ends at {wanted.end}",
                "jog it the other way",
            )
        unit = self._unit
        async with unit.loading:
            if self._mover.busy:
                # G: would start what is loaded, too.
                raise CannotDo("busy", "a move is loaded or under way", "disarm or stop it")
            try:
                await self._load(axis, motor, wanted)
                self._runs[motor] = wanted
                unit.by_hand.add(motor)
                await unit.set_going(f"G:{motor}", axis, motor, wanted.stops)
            except CannotDo:
                await unit.session.try_to_tell(f"GC:{motor}")
                raise
            except BaseException:
                # Cancelled: what is loaded must not wait for somebody's G.
                with suppress(LinkClosed):
                    unit.session.interrupt(f"GC:{motor}")
                raise

    async def _load(self, axis: str, motor: int, wanted: _Run) -> None:
        """Speeds and target, read back: a garbled digit would send the axis past its end."""
        session = self._unit.session
        await session.tell(f"D:{motor}{wanted.speeds}")
        await session.tell(f"A:{motor}{'-' if wanted.end < 0 else '+'}P{abs(wanted.end)}")
        speeds = await session.ask(f"?:D{motor}", triples(1))
        (target,) = entries(await session.ask(f"?:A{motor}", amounts(1)))
        if (speeds, target) != (wanted.speeds, wanted.end):
            raise CannotDo(
                "load-garbled",
                f"axis {axis}: the unit holds {target} at {speeds} in place of {wanted.end} at {wanted.speeds}",
                "check the cable; try again",
            )


def _lowered(axis: str, move: JogMove, limits: Bounds, stops: int) -> _Run:
    """Whole numbers that do not go beyond `move`. What needs a ramp of more than a second is done more slowly."""
    asked = abs(move.velocity_counts_s)
    f = min(SPEED_MAX, floor(asked * (1 + _ROUNDING)))
    if f < limits.start_min:
        raise CannotDo(
            "too-slow", f"axis {axis}: {asked:g} pulses/s is slower than it can go", f"at least {limits.start_min}"
        )
    s = limits.start_min
    f = min(f, s + floor(move.ramp_counts_s2 * RAMP_MAX_MS / 1000))
    r = max(1, ceil((f - s) / move.ramp_counts_s2 * 1000 - _ROUNDING))
    sign = 1 if move.velocity_counts_s > 0 else -1
    # The counter itself ends there (L3057).
    end = sign * DISTANCE_MAX if move.end_counts is None else max(-DISTANCE_MAX, min(DISTANCE_MAX, move.end_counts))
    return _Run(sign, s, f, r, end, stops)
