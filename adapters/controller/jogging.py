"""Axes moved by hand: a jog is good for a moment and renewed while somebody holds the key; silence stops the axis."""

import asyncio
import math
from collections.abc import Callable, Coroutine, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from adapters.contract import CannotDo, Driver, DriverFault, JogMove, Reading
from adapters.controller.status import Condition
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_until_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import Axis
from orchestrator.model.messages import JogRequest

HOLDERS_KEPT = 64
ROOM = 1e-9  # of a speed that was rounded on its way
SEEN_MOVING_NS = 150 * NS_PER_MS  # an axis that a poll finds at rest so long after its order has come to rest by itself


@dataclass(slots=True)
class _Jog:
    """One axis that is moved by hand. velocity, wanted: unit/s, of the last order that the controller has taken, and of
    the last that it was given; ordered_ns: when it had taken one."""

    holder: str
    until_ns: int
    velocity: float = 0.0
    wanted: float = 0.0
    ordered_ns: int | None = None


class Jogging:
    """The jogs of one controller. stopped(axis): told when one has ended, for whatever reason."""

    def __init__(
        self,
        driver: Driver,
        clock: Clock,
        condition: Condition,
        spawn: Callable[[Coroutine[Any, Any, None]], object],
        changed: Callable[[], None],
    ) -> None:
        self._driver = driver
        self._clock = clock
        self._condition = condition
        self._spawn = spawn
        self._changed = changed
        self._turn = asyncio.Lock()
        self._jogs: dict[str, _Jog] = {}
        self._ended: dict[str, str] = {}
        self._last_seq: dict[str, int] = {}

    # What the holder asks

    def take_seq(self, request: JogRequest) -> None:
        """Refuse a request that was overtaken by a later one: a late `go on` must not follow a stop.

        Raises `CannotDo`.
        """
        last = self._last_seq.pop(request.holder, 0)
        self._last_seq[request.holder] = max(last, request.seq)
        if len(self._last_seq) > HOLDERS_KEPT:
            del self._last_seq[next(iter(self._last_seq))]
        if request.seq <= last:
            raise CannotDo("out-of-order", f"request {request.seq} came after request {last}", "")

    async def jog(self, request: JogRequest) -> None:
        """Begin, change, go on with or stop jogs. Raises `CannotDo`; then the axis named does not jog by this call."""
        await self.stop([axis for axis, velocity in request.velocities.items() if velocity == 0], "the key was let go")
        until_ns = self._clock.now_ns() + request.valid_ms * NS_PER_MS
        moving = {axis: velocity for axis, velocity in request.velocities.items() if velocity != 0}
        for axis in moving:
            if axis not in self._jogs and not request.renew:
                self._begin(axis, _Jog(request.holder, until_ns))
        # All of them before the first order: it may take longer than it is good for, and is renewed on its way.
        jogs = {axis: self._jogs[axis] for axis in moving if axis in self._jogs}
        for jog in jogs.values():
            jog.until_ns = until_ns
        anew = {axis: jog for axis, jog in jogs.items() if jog.wanted != moving[axis]}
        for axis, jog in anew.items():
            jog.wanted = moving[axis]
        try:
            for axis in list(anew):
                await self._order(axis, anew.pop(axis), moving[axis])
        except BaseException:
            for axis, jog in anew.items():
                self._take_back(axis, jog)
            raise
        for axis in moving:
            if axis not in jogs:
                why = self._ended.get(axis, "it does not jog")
                raise CannotDo("not-jogging", f"axis {axis}: {why}", "press the key again")

    def _begin(self, axis: str, jog: _Jog) -> None:
        self._jogs[axis] = jog
        self._condition.jogging.add(axis)
        self._spawn(self._keep_time(axis, jog))

    async def _order(self, axis: str, jog: _Jog, velocity: float) -> None:
        async with self._turn:
            try:
                if self._jogs.get(axis) is jog:
                    await self._driver.jog(axis, self._move(axis, velocity))
                    jog.velocity, jog.ordered_ns = velocity, self._clock.now_ns()
            except BaseException as error:
                self._take_back(axis, jog)
                if jog.velocity == 0 and not isinstance(error, CannotDo):
                    # The order may have been taken all the same. On a link that is closed its stop is owed.
                    self._is_to_rest([axis])
                    with suppress(DriverFault, LinkClosed):
                        await self._driver.stop_axes([axis])
                raise
            if self._jogs.get(axis) is not jog:
                # It was stopped while the order was on its way: the stop may have come first.
                await self._driver.stop_axes([axis])
        self._changed()

    def _take_back(self, axis: str, jog: _Jog) -> None:
        """The controller was not given, or has not taken, the order that was wanted."""
        jog.wanted = jog.velocity
        if jog.velocity == 0:
            self._forget(axis, jog, "it could not begin")

    def _move(self, name: str, velocity: float) -> JogMove:
        """What the driver is asked for, after everything that forbids it. Raises `CannotDo`."""
        condition, axis = self._condition, self._condition.config.axes[name]
        reading = condition.online()
        condition.require_enabled([name])
        referenced = condition.referenced[name]
        fastest = axis.jog_speed(referenced)
        if abs(velocity) > fastest * (1 + ROOM):
            why = "" if referenced else " while it is not referenced"
            raise CannotDo(
                "too-fast",
                f"axis {name} may jog at {fastest:g} {axis.unit}/s at most{why}, not at {abs(velocity):g}",
                "go slower" if referenced else "go slower, or home it first",
            )
        counts_s = velocity * float(axis.counts_per_unit)
        limit = reading.axes[name].limit
        if limit in ("both", "forward" if counts_s > 0 else "reverse"):
            raise CannotDo("limit", f"axis {name} is on its {limit} limit switch", "jog the other way")
        end = self._end_counts(name, axis, counts_s, reading)
        return JogMove(counts_s, axis.limits.acceleration * float(axis.scale), end)

    def _end_counts(self, name: str, axis: Axis, counts_s: float, reading: Reading) -> int | None:
        limits = self._condition.limits_counts([name])[name]
        if limits is None:
            return None
        end = limits[1] if counts_s > 0 else limits[0]
        if (end - reading.axes[name].commanded_counts) * counts_s <= 0:
            raise CannotDo(
                "soft-limit",
                f"axis {name} is at its soft limit, {axis.to_unit(end):g} {axis.unit} (motor position)",
                "jog the other way",
            )
        return end

    # How jogs end

    async def _keep_time(self, axis: str, jog: _Jog) -> None:
        while self._jogs.get(axis) is jog:
            until_ns = jog.until_ns
            await sleep_until_ns(self._clock, until_ns)
            if jog.until_ns == until_ns and self._jogs.get(axis) is jog:
                await self.stop([axis], "nobody has renewed it")

    async def stop(self, axes: Iterable[str], reason: str) -> None:
        """Stop those of `axes` that jog."""
        jogging = [axis for axis in axes if axis in self._jogs]
        if not jogging:
            return
        for axis in jogging:
            self._forget(axis, self._jogs[axis], reason)
        self._is_to_rest(jogging)
        await self._driver.stop_axes(jogging)
        self._changed()

    async def stop_holder(self, holder: str, reason: str) -> None:
        """Stop what `holder` jogs."""
        await self.stop([axis for axis, jog in self._jogs.items() if jog.holder == holder], reason)

    def ended_all(self, reason: str) -> None:
        """All jogs have ended: the controller was stopped as a whole, or is lost."""
        for axis, jog in list(self._jogs.items()):
            self._forget(axis, jog, reason)

    def look(self, reading: Reading) -> None:
        """A poll: who rests has come to a limit, who is off or in trouble does not jog any more."""
        for axis, jog in list(self._jogs.items()):
            now = reading.axes[axis]
            if not now.enabled:
                self._forget(axis, jog, "its motor has switched off")
            elif jog.wanted != jog.velocity:
                pass  # it may have to rest for another speed
            elif jog.ordered_ns is not None and not now.moving and reading.at_ns > jog.ordered_ns + SEEN_MOVING_NS:
                # Told to stop all the same: on a bad line it may have been another one's answer that says so.
                reason = "it is on its limit switch" if now.limit != "none" else "it is at its soft limit"
                self._spawn(self.stop([axis], reason))

    def _is_to_rest(self, axes: Sequence[str]) -> None:
        """An order may have been on its way, and the stop may get lost: they rest only when somebody has seen it."""
        slowest_ns = math.ceil(max(self._slow_down_s(axis) for axis in axes) * 1e9)
        condition = self._condition
        condition.stopped_ns = self._clock.now_ns()
        condition.stopping_until_ns = condition.stopped_ns + max(slowest_ns, self._driver.capabilities.costs.stop_ns)
        condition.stop_unseen = True

    def _slow_down_s(self, axis: str) -> float:
        config = self._condition.config.axes[axis]
        return 0.1 + config.limits.velocity / config.limits.acceleration

    def _forget(self, axis: str, jog: _Jog, reason: str) -> None:
        if self._jogs.get(axis) is jog:
            del self._jogs[axis]
            self._condition.jogging.discard(axis)
            self._ended[axis] = reason
