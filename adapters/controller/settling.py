"""Following, settling, rest: how far axes are from where they are commanded to be, and when they have come to it."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field

from adapters.contract import Reading
from adapters.controller.status import Condition
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.model.state import Fault

LOOK_NS = 10 * NS_PER_MS
REST_LOOK_NS = 50 * NS_PER_MS


@dataclass(frozen=True, slots=True)
class Settled:
    """settled_s: by axis, from the end of its profile until it was seen in its window. reason: who has not settled."""

    settled_s: Mapping[str, float] = field(default_factory=dict[str, float])
    reason: str = ""


class Settling:
    """Deviations of one controller's axes, by the limits of the fleet file. refresh: reads and publishes at once."""

    def __init__(self, clock: Clock, condition: Condition, refresh: Callable[[], Awaitable[None]]) -> None:
        self._clock = clock
        self._condition = condition
        self._refresh = refresh

    def faults(self, reading: Reading) -> list[Fault]:
        """Axes that do not follow their command as closely as they must; those whose motor is off need not."""
        found: list[Fault] = []
        for name, axis in self._condition.config.axes.items():
            now = reading.axes[name]
            if axis.following_error is None or not now.enabled:
                continue
            off = abs(now.actual_counts - now.commanded_counts) / float(axis.scale)
            if off > axis.following_error:
                text = f"axis {name} is {off:g} {axis.unit} off its command; {axis.following_error:g} are allowed"
                remedy = "look for what holds it; then disable and enable it, which takes it as it stands"
                found.append(Fault(code="following-error", text=text, remedy=remedy, axis=name))
        return found

    async def rest(self, axes: Sequence[str], within_ns: int) -> bool:
        """Wait until none of `axes` moves; whether that was within `within_ns`, and the controller could be read."""
        until_ns = self._clock.now_ns() + within_ns
        while self._clock.now_ns() < until_ns:
            await self._refresh()
            reading = self._condition.reading
            if reading is None:
                return False
            if not any(reading.axes[name].moving for name in axes):
                return True
            await sleep_ns(self._clock, REST_LOOK_NS)
        return False

    async def wait(self, axes: Sequence[str]) -> Settled:
        """After the ends of the profiles of `axes`: until those with `done: in_position` are in their windows."""
        configs = self._condition.config.axes
        waiting = [name for name in axes if configs[name].done == "in_position"]
        began_ns, settled_s = self._clock.now_ns(), dict[str, float]()
        while True:
            await self._refresh()
            reading = self._condition.online()
            gone_s = (self._clock.now_ns() - began_ns) / NS_PER_S
            for name in list(waiting):
                axis, now = configs[name], reading.axes[name]
                off = abs(now.actual_counts - now.commanded_counts) / float(axis.scale)
                if off <= (axis.in_position_window or 0.0):
                    waiting.remove(name)
                    settled_s[name] = gone_s
                elif gone_s > axis.in_position_timeout_s:
                    text = f"axis {name} is still {off:g} {axis.unit} off its target after {gone_s:.3g} s"
                    return Settled(settled_s, f"{text}; its window is {axis.in_position_window:g}")
            if not waiting:
                return Settled(settled_s)
            await sleep_ns(self._clock, LOOK_NS)
