"""Jogging: an absolute move to the end position, with the jog's speed and ramp.

The controller's own jog (J:, L4859) is unsuitable: it runs at the minimum speed S without ramps, changes speed at once
(JD:, L5132), and ends only at a limit sensor. `A:` ends exactly at its target, with ramps, and sends no completion line
(L4774). D: and A: are refused while the axis is busy (L4937, L3247), so that every change requires a stop. Jogs do not
use the prebuffers, and arming a step deletes what they leave in the execution buffer.
"""

import asyncio
from contextlib import suppress
from dataclasses import dataclass, replace
from math import ceil, floor

from adapters.contract import JogMove
from adapters.shrc203 import fleetaxes
from adapters.shrc203.moves import ShrcMover
from adapters.shrc203.shapes.trapezoid import DISTANCE_MAX, RAMP_MAX_MS, SPEED_MAX, ShrcBounds
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import READY, STATUS, AxisStatus, parse_entries, parse_status, pulse_list, speed_list
from adapters.shrc203.wire.status import ERRORS, stop_reason
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller

_POLL_NS = 5 * NS_PER_MS
_REST_MARGIN_NS = NS_PER_S  # beyond its ramp, for an axis to come to rest
_JOG_OVER = -1  # not a valid number of stops: marks a jog that is over
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class _JogRun:
    """The last jog command of an axis, pls/s and ms. stops: its number of stops at that time."""

    sign: int
    s: int
    f: int
    r: int
    end: int
    stops: int

    @property
    def speed_triple(self) -> str:
        return f"S{self.s}F{self.f}R{self.r}"


class ShrcJogging:
    """All jogs of one connection."""

    def __init__(self, config: Controller, clock: Clock, unit: ShrcState, mover: ShrcMover) -> None:
        self._config = config
        self._clock = clock
        self._unit = unit
        self._mover = mover
        self._runs: dict[int, _JogRun] = {}
        self._turns = {motor: asyncio.Lock() for motor in fleetaxes.motor_numbers(config).values()}

    async def start_jog(self, axis: str, move: JogMove) -> None:
        """Begin a jog, or change to `move`. Raises `Refusal`, also when a stop overtakes the call."""
        unit, motor = self._unit, fleetaxes.motor_number(self._config.axes[axis])
        stop_count = unit.stops.stop_count(motor)
        async with self._turns[motor]:
            unit.stops.require_no_stop(axis, motor, stop_count)
            wanted_run = _make_run(axis, move, fleetaxes.axis_bounds(self._config.axes[axis]), stop_count)
            await self._mover.empty_prebuffers()
            state = await self._read_axis(motor)
            if state.is_busy:
                held_run = self._runs.get(motor)
                if held_run is None or motor not in unit.jogging_motors:
                    raise Refusal("moving", f"axis {axis} is moving", "wait for its end, or stop it")
                if held_run == wanted_run:
                    return
                state = await self._bring_to_rest(axis, motor, held_run)
            await self._begin_jog(axis, motor, wanted_run, state)

    async def _read_axis(self, motor: int) -> AxisStatus:
        return parse_status(await self._unit.session.send_query("Q:SPC", STATUS), self._unit.controllable)[motor]

    async def _bring_to_rest(self, axis: str, motor: int, held: _JogRun) -> AxisStatus:
        self._runs[motor] = replace(held, stops=_JOG_OVER)
        self._unit.brake_motors([motor])
        until_ns = self._clock.now_ns() + held.r * NS_PER_MS + _REST_MARGIN_NS
        while await self._unit.session.send_query(f"!:{motor}S", READY) == "B":
            if self._clock.now_ns() > until_ns:
                raise ControllerFault("not-stopping", f"axis {axis} does not stop", "stop it at the controller", axis)
            await sleep_ns(self._clock, _POLL_NS)
        return await self._read_axis(motor)

    async def _begin_jog(self, axis: str, motor: int, wanted: _JogRun, now: AxisStatus) -> None:
        if now.word & ERRORS:
            raise Refusal("fault", stop_reason(axis, now), "clear it with `tutti reset`")
        if wanted.sign * (wanted.end - now.counts) <= 0:
            raise Refusal(
                "at-end",
                f"axis {axis} is at {now.counts} pulses; its range in this direction ends at {wanted.end}",
                "jog in the other direction",
            )
        unit = self._unit
        async with unit.loading:
            if self._mover.is_busy:
                # G: would start a loaded move, too.
                raise Refusal("busy", "a move is loaded or in progress", "disarm or stop it")
            try:
                await self._load_jog(axis, motor, wanted)
                self._runs[motor] = wanted
                unit.jogging_motors.add(motor)
                await unit.start_motion(f"G:{motor}", axis, motor, wanted.stops)
            except Refusal:
                await unit.session.try_setting(f"GC:{motor}")
                raise
            except BaseException:
                # Cancelled: the loaded move must not wait for a later G.
                with suppress(LinkClosed):
                    unit.session.write_at_once(f"GC:{motor}")
                raise

    async def _load_jog(self, axis: str, motor: int, wanted: _JogRun) -> None:
        """Load speeds and target, and read them back: a garbled digit would move the axis beyond its end."""
        session = self._unit.session
        await session.send_setting(f"D:{motor}{wanted.speed_triple}")
        await session.send_setting(f"A:{motor}{'-' if wanted.end < 0 else '+'}P{abs(wanted.end)}")
        speeds = await session.send_query(f"?:D{motor}", speed_list(1))
        (target,) = parse_entries(await session.send_query(f"?:A{motor}", pulse_list(1)))
        if (speeds, target) != (wanted.speed_triple, wanted.end):
            raise Refusal(
                "load-garbled",
                f"axis {axis}: the controller has {target} at {speeds}, not {wanted.end} at {wanted.speed_triple}",
                "check the cable; try again",
            )


def _make_run(axis: str, move: JogMove, limits: ShrcBounds, stops: int) -> _JogRun:
    """Return whole numbers that do not exceed `move`. A ramp of more than a second is replaced by a lower speed."""
    speed = abs(move.velocity_counts_s)
    f = min(SPEED_MAX, floor(speed * (1 + _ROUNDING)))
    if f < limits.start_min:
        raise Refusal(
            "too-slow", f"axis {axis}: {speed:g} pulses/s is below its lowest speed", f"at least {limits.start_min}"
        )
    s = limits.start_min
    f = min(f, s + floor(move.ramp_counts_s2 * RAMP_MAX_MS / 1000))
    r = max(1, ceil((f - s) / move.ramp_counts_s2 * 1000 - _ROUNDING))
    sign = 1 if move.velocity_counts_s > 0 else -1
    # The counter itself ends there (L3057).
    end = sign * DISTANCE_MAX if move.end_counts is None else max(-DISTANCE_MAX, min(DISTANCE_MAX, move.end_counts))
    return _JogRun(sign=sign, s=s, f=f, r=r, end=end, stops=stops)
