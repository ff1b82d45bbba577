"""Axes moved by hand, and the search for the reference: programs like those of steps, started at once.

A jog is a move to the end of its way, so that it ends exactly there by itself; running on (g, L2034) would end at a
limit switch only. Parameters hold for the next command (L2345), so that every change goes by way of a stop.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, floor, sqrt

from adapters.contract import CannotDo, DriverFault, JogMove
from adapters.smc30.options import Options
from adapters.smc30.session import Busy
from adapters.smc30.unitaxis import POSITION_MAX, RAMP_MAX, TOP_MIN, Bounds, bounds, homing_rate, only_axis
from adapters.smc30.unitstate import UnitState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import Axis, Controller

_REST_ROOM_NS = 2 * NS_PER_S  # beyond its ramp, for a unit to come to rest and to say so
_LOOK_NS = 100 * NS_PER_MS
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Run:
    """What the axis was last set going with by hand: steps/s, steps, and where it ends. stops: given by then."""

    s: int
    t: int
    r: int
    begin: int
    end: int
    stops: int

    @property
    def sign(self) -> int:
        return 1 if self.end > self.begin else -1

    @property
    def ramp_s(self) -> float:
        return 0.0 if self.t <= self.s else 2 * self.r / (self.s + self.t)

    @property
    def program(self) -> tuple[str, ...]:
        return f"S{self.s}", f"T{self.t}", f"R{self.r}", f"G{self.end:+d}"


class Hand:
    """All that is moved by hand on one connection. busy: whether a step is loaded."""

    def __init__(
        self, config: Controller, options: Options, clock: Clock, unit: UnitState, busy: Callable[[], bool]
    ) -> None:
        self._name, self._axis = only_axis(config)
        self._options = options
        self._clock = clock
        self._unit = unit
        self._busy = busy
        self._wanted: JogMove | None = None
        self.run: Run | None = None
        self.began_ns = 0
        """When the motion of `run` began, about."""
        self.told_ns: int | None = None
        """When the unit had taken the order to begin it; None before."""

    # Jogging

    async def jog(self, move: JogMove) -> None:
        """Begin, or change to `move`. Raises `CannotDo`, also when a stop overtakes the call."""
        unit = self._unit
        since = unit.session.stops
        async with unit.loading:
            await unit.stopped()
            unit.session.require_no_stop(since)
            self._require_free()
            run = self.run
            if (await unit.status()).busy:
                if unit.doing != "jog" or run is None:
                    raise CannotDo("moving", f"axis {self._name} is moving", "wait, or stop it")
                if move == self._wanted and run.stops == since:
                    return
                self._wanted = None
                # Not a stop that others give: what was asked for after it may begin.
                unit.stop("Z")
                since += 1
                if await unit.rest(self._clock.now_ns() + round(run.ramp_s * NS_PER_S) + _REST_ROOM_NS) is None:
                    raise DriverFault(
                        "not-stopping", f"axis {self._name} does not stop", "stop it at the unit", self._name
                    )
                await unit.stopped()
            async with unit.in_one_go():
                wanted = _lowered(self._name, move, bounds(self._axis), await unit.ready(), since)
                await unit.load(wanted.program, since)
                self._require_free()
                await unit.require_not_restarted("told how to be jogged", "jog it again; its counter has begun anew")
                self.run, self._wanted, self.told_ns = wanted, move, None
                answer = await unit.run(since, "jog")
            self.told_ns = answer.at_ns
            self.began_ns = answer.at_ns + len(wanted.program) * self._options.line_us * NS_PER_US
            unit.limit = "none"

    def _require_free(self) -> None:
        if self._busy():
            raise CannotDo("busy", "a step is loaded or under way", "disarm or stop it")
        if not self._unit.enabled:
            raise CannotDo("not-enabled", f"axis {self._name} is not enabled", f"enable {self._name} first")

    # Homing

    async def home(self, found: Callable[[str], None]) -> Mapping[str, CannotDo]:
        """Look for the reference; the counter is 0 there. Raises `CannotDo` when it was not begun."""
        unit = self._unit
        since = unit.session.stops
        async with unit.loading:
            await unit.stopped()
            self._require_free()
            async with unit.in_one_go():
                await unit.ready()
                await unit.load(homing_program(self._axis), since)
                await unit.require_not_restarted("told how to find its reference", "home it again")
                await unit.run(since, "home")
        try:
            while (await unit.status()).busy:
                await sleep_ns(self._clock, _LOOK_NS)
            why = await self._why_not(since)
        except BaseException:
            # Nobody waits any more for what looks for it.
            with suppress(LinkClosed):
                unit.stop("Z")
            raise
        finally:
            unit.doing = "nothing"
        if why:
            text = f"axis {self._name} has not found its reference: {why}"
            return {self._name: CannotDo("homing-failed", text, "look at its inputs")}
        unit.lost = unit.overflow = False
        unit.limit = "none"
        found(self._name)
        return {}

    async def _why_not(self, since: int) -> str:
        """What the unit says of a search that has ended; empty: it has found it."""
        unit = self._unit
        await unit.stopped()
        try:
            unit.rest_counts = counts = await unit.position()
            if unit.session.stops != since:
                return "it was stopped"
            if not await unit.holds_sentinel():
                return "the unit was restarted"
            if unit.program_error:
                return "its program has ended with an error"
            if counts != 0:
                return f"it stands at {counts}"
            method = self._axis.homing.method
            if method != "default":
                inputs, _ = await unit.points()
                if not inputs[int(method[-1])]:
                    return f"it was stopped by something else than user input {method[-1]}"
        except Busy:
            return "another program runs"
        return ""


def homing_program(axis: Axis) -> tuple[str, ...]:
    """H, at the start rate to the input that it watches (L2076-L2086); or on, without ramps, until a user input is 1
    (L2132-L2138), and the counter to 0 (L1829-L1846)."""
    rate = homing_rate(axis)
    sign = "+" if axis.homing.direction == "positive" else "-"
    if axis.homing.method == "default":
        return f"S{rate}", f"T{max(rate, TOP_MIN)}", "R1", f"H{sign}"
    number = axis.homing.method[-1]
    return f"S{min(rate + 1, 2000)}", f"T{rate}", "R1", f"N{number}{number}.91", f"g{sign}", "I1"


def _lowered(name: str, move: JogMove, limits: Bounds, now: int, stops: int) -> Run:
    """Whole numbers that do not go beyond `move`. What needs a longer ramp than the unit has is done more slowly."""
    asked = abs(move.velocity_counts_s)
    t = min(limits.top, floor(asked * (1 + _ROUNDING)))
    if t < TOP_MIN:
        raise CannotDo("too-slow", f"axis {name}: {asked:g} steps/s is slower than it can go", f"at least {TOP_MIN}")
    sign = 1 if move.velocity_counts_s > 0 else -1
    end = sign * POSITION_MAX if move.end_counts is None else max(-POSITION_MAX, min(POSITION_MAX, move.end_counts))
    way = sign * (end - now)
    if way <= 0:
        raise CannotDo(
            "at-end",
            f"axis {name} stands at {now} steps; in this direction its way ends at {end}",
            "jog it the other way",
        )
    s = min(limits.start_min, limits.start_max)
    longest = min(RAMP_MAX, way // 2)
    t = min(t, floor(sqrt(s**2 + 2 * move.ramp_counts_s2 * longest)))
    if t <= s:
        # Without a ramp, at no more than what it may start with (L2286).
        return Run(min(t + 1, 2000), t, 1, now, end, stops)
    r = max(1, min(longest, ceil((t**2 - s**2) / (2 * move.ramp_counts_s2) - _ROUNDING)))
    return Run(s, t, r, now, end, stops)
