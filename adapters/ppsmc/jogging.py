"""Jogging: an absolute move to the end position, with the jog's speed and ramp.

`fast`, `run` and `spin` end only at a limit switch, and are refused while another axis moves. `goto` is accepted then
(L2003), ends exactly at its target, and has the ramps of acc and dec. But speeds can be set only while the whole
controller is idle: a jog that needs other speeds than the loaded ones brings all jogging axes to rest for a moment, and
starts them again.
"""

import asyncio
from contextlib import suppress
from dataclasses import dataclass, replace
from math import floor

from adapters.contract import JogMove
from adapters.ppsmc import fleetaxes, loading
from adapters.ppsmc.moves import PpSmcMover
from adapters.ppsmc.replies import ASK_SETTINGS, StatusBits, parse_settings
from adapters.ppsmc.trapezoid import POSITION_MAX, PpSmcBounds
from adapters.ppsmc.unitstate import PpSmcReading, PpSmcState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller

_POLL_NS = 5 * NS_PER_MS
_REST_MARGIN_NS = NS_PER_S  # beyond its ramp, for an axis to come to rest
_READY_LAG_NS = 500 * NS_PER_MS  # ready bits may lag behind a start
_JOG_OVER = -1  # not a valid number of stops: marks a jog that is over
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class _JogRun:
    """The last jog command of an axis. profile: as in `loading.PROFILE`. stops: its number of stops at that time."""

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


class PpSmcJogging:
    """All jogs of one connection."""

    def __init__(self, config: Controller, clock: Clock, unit: PpSmcState, mover: PpSmcMover) -> None:
        self._config = config
        self._clock = clock
        self._unit = unit
        self._mover = mover
        self._runs: dict[int, _JogRun] = {}
        self._turn = asyncio.Lock()

    async def start_jog(self, axis: str, move: JogMove) -> None:
        """Begin a jog, or change to `move`. Raises `Refusal`, also when a stop overtakes the call."""
        unit, motor = self._unit, fleetaxes.axis_number(self._config.axes[axis])
        stop_count = unit.stops.stop_count(motor)
        async with self._turn, unit.loading:
            unit.require_enabled([axis])
            unit.stops.require_no_stop(axis, motor, stop_count)
            if self._mover.move is not None:
                raise Refusal("busy", "a move is loaded or in progress", "disarm or stop it")
            wanted_run = _make_run(axis, motor, move, fleetaxes.axis_bounds(self._config.axes[axis]), stop_count)
            look = await self._read_state()
            held_run = self._running_jog(motor, look)
            if not look.is_ready(motor) and held_run is None:
                raise Refusal("moving", f"axis {axis} is moving", "wait for its end, or stop it")
            if held_run == wanted_run:
                return
            onward: list[_JogRun] = []
            if unit.profiles.get(motor) == wanted_run.profile:
                if held_run is not None:
                    look = await self._bring_to_rest([held_run])
            else:
                onward = [
                    run
                    for other_motor in self._runs
                    if other_motor != motor and (run := self._running_jog(other_motor, look))
                ]
                look = await self._bring_to_rest([*onward, *([held_run] if held_run is not None else [])])
                await self._load_speeds(wanted_run, look)
            self._require_range(wanted_run, look)
            await self._begin_jog(wanted_run, look)
            for run in onward:
                # Stopped meanwhile, or already at its end: it stays at its position.
                with suppress(Refusal):
                    unit.stops.require_no_stop(run.axis, run.motor, run.stops)
                    self._require_range(run, look)
                    await self._begin_jog(run, look)

    async def _read_state(self) -> PpSmcReading:
        look = await self._unit.read_state()
        if look.is_blocked:
            raise Refusal("blocked", "the controller is blocked", "unblock it with `tutti reset`")
        if look.program_runs:
            raise Refusal("busy", "a program runs in the controller", "wait for its end, or stop it")
        return look

    def _running_jog(self, motor: int, look: PpSmcReading) -> _JogRun | None:
        """Return the jog of an axis, as long as the axis moves by it and was not stopped."""
        run = self._runs.get(motor)
        if run is None or look.is_ready(motor) or motor not in self._unit.jogging_motors:
            return None
        return run

    async def _bring_to_rest(self, runs: list[_JogRun]) -> PpSmcReading:
        for run in runs:
            self._runs[run.motor] = replace(run, stops=_JOG_OVER)
        if runs:
            self._unit.brake_axes(run.motor for run in runs)
        until_ns = self._clock.now_ns() + max((run.ramp_ns for run in runs), default=0) + _REST_MARGIN_NS
        look = await self._read_state()
        while moving_axes := [run.axis for run in runs if not look.is_ready(run.motor)]:
            if self._clock.now_ns() > until_ns:
                raise ControllerFault(
                    "not-stopping", f"axis {moving_axes[0]} does not stop", "stop it at the controller", moving_axes[0]
                )
            await sleep_ns(self._clock, _POLL_NS)
            look = await self._read_state()
        return look

    async def _load_speeds(self, wanted: _JogRun, look: PpSmcReading) -> None:
        """Load speeds and read them back: a garbled digit would make the axis too fast."""
        if not look.is_idle:
            raise Refusal("moving", "another axis of the controller moves", "wait for its end, or stop it")
        lines = [f"{n}{wanted.motor}:{v}" for n, v in zip(loading.PROFILE, wanted.profile, strict=True)]
        held_settings = parse_settings(
            (await self._unit.session.send_once(lines, ASK_SETTINGS)).reply_texts(ASK_SETTINGS)
        )
        self._unit.profiles.pop(wanted.motor, None)
        loading.require_profile(wanted.axis, wanted.motor, wanted.profile, held_settings)
        self._unit.profiles[wanted.motor] = wanted.profile

    def _require_range(self, wanted: _JogRun, look: PpSmcReading) -> None:
        counts, bits = look.counts[wanted.motor], look.bits[wanted.motor]
        if counts is None or wanted.sign * (wanted.end - counts) <= 0:
            raise Refusal(
                "at-end",
                f"axis {wanted.axis} is at {counts} steps; its range in this direction ends at {wanted.end}",
                "jog in the other direction",
            )
        if bits & (StatusBits.LIMIT_FORWARD if wanted.sign > 0 else StatusBits.LIMIT_REVERSE):
            raise Refusal("limit", f"axis {wanted.axis} is on its limit switch", "jog in the other direction")

    async def _begin_jog(self, wanted: _JogRun, look: PpSmcReading) -> None:
        unit, start_counts = self._unit, look.counts[wanted.motor]
        self._runs[wanted.motor] = wanted
        unit.jogging_motors.add(wanted.motor)
        target = fleetaxes.format_position(wanted.end, unit.gears[wanted.motor])
        await unit.start_motion(f"goto{wanted.motor}:{target}", wanted.axis, wanted.motor, wanted.stops)
        until_ns = self._clock.now_ns() + _READY_LAG_NS
        while (look_now := await self._read_state()).is_ready(wanted.motor) and look_now.counts[
            wanted.motor
        ] == start_counts:
            unit.stops.require_no_stop(wanted.axis, wanted.motor, wanted.stops)
            if self._clock.now_ns() > until_ns:
                unit.brake_axes([wanted.motor])
                raise Refusal(
                    "not-started",
                    f"axis {wanted.axis} does not move after `goto{wanted.motor}:{target}`",
                    "check `emips` and the messages on the controller's screen",
                )
            await sleep_ns(self._clock, _POLL_NS)


def _make_run(axis: str, motor: int, move: JogMove, limits: PpSmcBounds, stops: int) -> _JogRun:
    """Return whole numbers that do not exceed `move`."""
    speed = abs(move.velocity_counts_s)
    f = floor(min(speed, limits.speed) * (1 + _ROUNDING))
    if f < max(1, limits.start_min):
        raise Refusal(
            "too-slow", f"axis {axis}: {speed:g} steps/s is below its lowest speed", f"at least {limits.start_min}"
        )
    s = min(f, max(1, limits.start_min))
    ramp = min(1000, floor(move.ramp_counts_s2 / 1000 * (1 + _ROUNDING)))
    if ramp < 1:
        # Gentler than the controller's slowest ramp: only at a speed that needs no ramp.
        s = f = min(f, limits.start_max)
        ramp = 1
    sign = 1 if move.velocity_counts_s > 0 else -1
    # The counter itself ends there (L2022).
    end = sign * POSITION_MAX if move.end_counts is None else max(-POSITION_MAX, min(POSITION_MAX, move.end_counts))
    return _JogRun(axis=axis, motor=motor, sign=sign, profile=(s, f, ramp, ramp), end=end, stops=stops)
