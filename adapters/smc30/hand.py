"""Manual motion: jogs and the search for the reference, by programs like those of steps, started at once.

A jog is a move to its end position, so that it ends exactly there by itself; continuous running (g, L2034) would end
only at a limit switch. Parameters apply to the next command (L2345), so that every change requires a stop.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from math import ceil, floor, sqrt

from adapters.contract import JogMove
from adapters.smc30.options import Smc30DriverOptions
from adapters.smc30.session import ControllerBusy
from adapters.smc30.unitaxis import POSITION_MAX, RAMP_MAX, TOP_MIN, Smc30Bounds, axis_bounds, homing_rate, only_axis
from adapters.smc30.unitstate import Smc30State
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Axis, Controller

_REST_MARGIN_NS = 2 * NS_PER_S  # beyond its ramp, for a controller to come to rest and to report it
_POLL_NS = 100 * NS_PER_MS
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class ManualRun:
    """The last manual motion of the axis: steps/s, steps, and its end position. stops: number of stops at that time.
    condition: a program line that says what ends it before."""

    s: int
    t: int
    r: int
    begin: int
    end: int
    stops: int
    condition: str = ""

    @property
    def direction_sign(self) -> int:
        return 1 if self.end > self.begin else -1

    @property
    def ramp_s(self) -> float:
        return 0.0 if self.t <= self.s else 2 * self.r / (self.s + self.t)

    @property
    def program_lines(self) -> tuple[str, ...]:
        condition = (self.condition,) if self.condition else ()
        return f"S{self.s}", f"T{self.t}", f"R{self.r}", *condition, f"G{self.end:+d}"


class Smc30ManualMotion:
    """All manual motion on one connection. busy: returns whether a step is loaded."""

    def __init__(
        self, config: Controller, options: Smc30DriverOptions, clock: Clock, unit: Smc30State, busy: Callable[[], bool]
    ) -> None:
        self._name, self._axis = only_axis(config)
        self._options = options
        self._clock = clock
        self._unit = unit
        self._busy = busy
        self._wanted: JogMove | None = None
        self.run: ManualRun | None = None
        self.began_ns = 0
        """Approximate begin of the motion of `run`."""
        self.accepted_ns: int | None = None
        """When the controller accepted the command that begins it; None before."""

    # Jogs

    async def start_jog(self, move: JogMove, condition: str = "") -> None:
        """Begin a jog, or change to `move`. Raises `Refusal`, also when a stop overtakes the call. condition: a program
        line that ends it before."""
        unit = self._unit
        stop_count = unit.session.stops
        async with unit.loading:
            await unit.wait_for_stops()
            unit.session.require_no_stop(stop_count)
            self._require_free()
            run = self.run
            if (await unit.read_status()).busy:
                if unit.doing != "jog" or run is None:
                    raise Refusal("moving", f"axis {self._name} is moving", "wait for its end, or stop it")
                if move == self._wanted and run.stops == stop_count:
                    return
                self._wanted = None
                # Unlike an external stop: a request that came after it may begin.
                unit.write_stop("Z")
                stop_count += 1
                if (
                    await unit.wait_until_ready(self._clock.now_ns() + round(run.ramp_s * NS_PER_S) + _REST_MARGIN_NS)
                    is None
                ):
                    raise ControllerFault(
                        "not-stopping", f"axis {self._name} does not stop", "stop it at the controller", self._name
                    )
                await unit.wait_for_stops()
            if condition:
                # Loaded and verified in two turns: in one, a longer program would make the adapter silent for too long.
                async with unit.exclusive_turn():
                    await self._load_run(move, stop_count, condition)
            async with unit.exclusive_turn():
                wanted_run = await self._load_run(move, stop_count, condition)
                self._require_free()
                await unit.require_not_restarted("loaded with its jog", "jog it again; its counter was reset")
                self.run, self._wanted, self.accepted_ns = wanted_run, move, None
                answer = await unit.run_program(stop_count, "jog")
            self.accepted_ns = answer.at_ns
            self.began_ns = answer.at_ns + len(wanted_run.program_lines) * self._options.line_us * NS_PER_US
            unit.limit = "none"

    async def _load_run(self, move: JogMove, stops: int, condition: str) -> ManualRun:
        """Load the program of a jog from where the axis stands; one that is loaded already is verified. Raises
        `Refusal`."""
        unit = self._unit
        bounds, counts = axis_bounds(self._axis), await unit.require_ready()
        run = replace(_make_run(self._name, move, bounds, counts, stops), condition=condition)
        await unit.load_program(run.program_lines, stops)
        return run

    def _require_free(self) -> None:
        if self._busy():
            raise Refusal("busy", "a step is loaded or in progress", "disarm or stop it")
        if not self._unit.enabled:
            raise Refusal("not-enabled", f"axis {self._name} is not enabled", f"enable {self._name} first")

    # Homing

    async def find_reference(self, found: Callable[[str], None]) -> Mapping[str, Refusal]:
        """Search for the reference; the counter is 0 there. Raises `Refusal` when the search did not begin."""
        unit = self._unit
        stop_count = unit.session.stops
        async with unit.loading:
            await unit.wait_for_stops()
            self._require_free()
            async with unit.exclusive_turn():
                await unit.require_ready()
                await unit.load_program(homing_program(self._axis), stop_count)
                await unit.require_not_restarted("loaded with its reference search", "home it again")
                await unit.run_program(stop_count, "home")
        try:
            while (await unit.read_status()).busy:
                await sleep_ns(self._clock, _POLL_NS)
            reason = await self._search_failure(stop_count)
        except BaseException:
            # After a cancellation nothing waits for the searching axis.
            with suppress(LinkClosed):
                unit.write_stop("Z")
            raise
        finally:
            unit.doing = "nothing"
        if reason:
            text = f"axis {self._name} has not found its reference: {reason}"
            return {self._name: Refusal("homing-failed", text, "check its inputs")}
        unit.lost = unit.overflow = False
        unit.limit = "none"
        found(self._name)
        return {}

    async def _search_failure(self, since: int) -> str:
        """Return why a search has failed; empty: it has succeeded."""
        unit = self._unit
        await unit.wait_for_stops()
        try:
            unit.rest_counts = counts = await unit.read_position()
            if unit.session.stops != since:
                return "it was stopped"
            if not await unit.holds_sentinel():
                return "the controller was restarted"
            if unit.program_error:
                return "its program has ended with an error"
            if counts != 0:
                return f"it is at {counts}"
            method = self._axis.homing.method
            if method != "default":
                inputs, _ = await unit.read_points()
                if not inputs[int(method[-1])]:
                    return f"it was stopped by something other than user input {method[-1]}"
        except ControllerBusy:
            return "another program runs"
        return ""


def homing_program(axis: Axis) -> tuple[str, ...]:
    """Return the homing program: H, at the start rate to the input that it watches (L2076-L2086); or continuous motion,
    without ramps, until a user input is 1 (L2132-L2138), and the counter to 0 (L1829-L1846)."""
    rate = homing_rate(axis)
    sign = "+" if axis.homing_sign > 0 else "-"
    if axis.homing.method == "default":
        return f"S{rate}", f"T{max(rate, TOP_MIN)}", "R1", f"H{sign}"
    number = axis.homing.method[-1]
    return f"S{min(rate + 1, 2000)}", f"T{rate}", "R1", f"N{number}{number}.91", f"g{sign}", "I1"


def _make_run(name: str, move: JogMove, limits: Smc30Bounds, now: int, stops: int) -> ManualRun:
    """Return whole numbers that do not exceed `move`. A ramp longer than the controller supports is replaced by a lower
    rate."""
    rate = abs(move.velocity_counts_s)
    t = min(limits.top, floor(rate * (1 + _ROUNDING)))
    if t < TOP_MIN:
        raise Refusal("too-slow", f"axis {name}: {rate:g} steps/s is below its lowest rate", f"at least {TOP_MIN}")
    sign = 1 if move.velocity_counts_s > 0 else -1
    end = sign * POSITION_MAX if move.end_counts is None else max(-POSITION_MAX, min(POSITION_MAX, move.end_counts))
    way = sign * (end - now)
    if way <= 0:
        raise Refusal(
            "at-end",
            f"axis {name} is at {now} steps; its range in this direction ends at {end}",
            "jog in the other direction",
        )
    s = min(limits.start_min, limits.start_max)
    longest = min(RAMP_MAX, way // 2)
    t = min(t, floor(sqrt(s**2 + 2 * move.ramp_counts_s2 * longest)))
    if t <= s:
        # Without a ramp, at no more than its start rate (L2286).
        return ManualRun(s=min(t + 1, 2000), t=t, r=1, begin=now, end=end, stops=stops)
    r = max(1, min(longest, ceil((t**2 - s**2) / (2 * move.ramp_counts_s2) - _ROUNDING)))
    return ManualRun(s=s, t=t, r=r, begin=now, end=end, stops=stops)
