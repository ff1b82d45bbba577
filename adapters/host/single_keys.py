"""Which controllers are published on the keys of their own: those that some process subscribes to.

One watch says whether there is any such process. While there is one, each controller has a watch of its own, until none
has subscribed for ten seconds.
"""

from collections.abc import Iterable
from functools import partial

from orchestrator.bus.base import Bus, BusDeclaration
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_S, Clock, ClockTimer
from orchestrator.clock.owner import TaskOwner

UNWATCHED_NS = 10 * NS_PER_S


class SingleKeys:
    """Knows which of a host's controllers are subscribed to. controllers: all of them."""

    def __init__(self, bus: Bus, keys: FleetKeys, clock: Clock, controllers: Iterable[str]) -> None:
        self._bus, self._keys, self._clock = bus, keys, clock
        self._controllers = list(controllers)
        self._is_any_watched = False
        self._watched: dict[str, bool] = {}
        """By controller that has a watch."""
        self._declared: list[BusDeclaration] = []
        self._watches: list[BusDeclaration] = []
        self._tasks = TaskOwner()
        self._timer: ClockTimer | None = None

    async def start(self) -> None:
        """Watch."""
        self._declared.append(await self._bus.watch_subscribers(self._keys.controller(), self._note_any))

    async def close(self) -> None:
        """End it."""
        if self._timer is not None:
            self._timer.cancel()
        self._tasks.cancel_all()
        for declaration in [*self._declared, *self._watches]:
            await declaration.undeclare()

    def is_watched(self, controller: str) -> bool:
        """Whether to publish a controller on the keys of its own; also while that is not known yet."""
        return self._is_any_watched and self._watched.get(controller, True)

    def _note_any(self, matches: bool) -> None:  # noqa: FBT001 - a callback of the bus
        self._is_any_watched = matches
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if not matches:
            self._timer = self._clock.call_at_ns(self._clock.now_ns() + UNWATCHED_NS, self._end_watches)
        elif not self._watches:
            self._tasks.spawn(self._watch_each())

    async def _watch_each(self) -> None:
        for controller in self._controllers:
            callback = partial(self._watched.__setitem__, controller)
            self._watches.append(await self._bus.watch_subscribers(self._keys.controller(controller), callback))
            # A watch says nothing where there is no subscriber.
            self._watched.setdefault(controller, False)

    def _end_watches(self) -> None:
        watches, self._watches = self._watches, []
        self._watched.clear()
        for watch in watches:
            self._tasks.spawn(watch.undeclare())
