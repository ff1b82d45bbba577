"""Leases as the fleet sees them: their records, and what is published of them."""

import asyncio
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import timedelta
from typing import NamedTuple

from orchestrator.bus.base import Bus, Priority, RequestHandler
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_S, NS_PER_US
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.messages import JogRoom
from orchestrator.model.queue import format_utc, parse_utc
from orchestrator.model.report import LeaseState

SHOWN_FROM_NS = 10 * NS_PER_S  # the end of a lease that its client renews all the time says nothing


class LeaseUser(NamedTuple):
    """What acquires a lease: the holder's id, the user behind it, and the reason that others are shown.

    session: the session that the lease ends with; empty: none."""

    holder: str
    actor: str
    what: str
    session: str = ""


@dataclass(frozen=True, slots=True)
class LeaseHold:
    """The lease of one holder.

    axes: `controller.axis`. until_ns: when it expires unless renewed; None: never.
    brief: it ends soon; other requests wait for that instead of being refused.
    idle: the adapters do not have it: the axes are reserved for the holder, which may not move them.
    acquisition: increases with each acquisition.
    session: the session that it ends with, enforced by the adapters; empty: none.
    rooms: of axes that move bodies of zones, where they are jogged; None: that is not known yet.
    """

    holder: str
    actor: str
    what: str
    axes: tuple[str, ...]
    until_ns: int | None
    brief: bool = False
    idle: bool = False
    acquisition: int = 0
    session: str = ""
    rooms: Mapping[str, JogRoom] | None = None
    sending: asyncio.Lock = field(default_factory=asyncio.Lock, compare=False)
    """Held while it is sent to the adapters, so that its rooms arrive in their order."""

    @property
    def lacks_rooms(self) -> bool:
        """Whether it is of manual control, and is not sent to the adapters before its rooms are known."""
        return self.until_ns is not None and self.rooms is None and not self.idle

    def find_room(self, axis: str) -> JogRoom | None:
        """Where an axis of it is jogged; None: wherever its soft limits allow."""
        return None if self.rooms is None else self.rooms.get(axis)

    def renew(self, before: "LeaseHold") -> "LeaseHold":
        """This one as the renewal of one that there is."""
        return replace(
            self,
            idle=self.idle or before.idle,
            acquisition=before.acquisition,
            rooms=before.rooms,
            sending=before.sending,
        )


def find_room(holds: Iterable[LeaseHold], axis: str) -> JogRoom | None:
    """Where an axis is jogged by the holder of its lease; None: wherever its soft limits allow."""
    return next((room for hold in holds if (room := hold.find_room(axis)) is not None), None)


class LeaseStates:
    """Publishes the leases of the fleet."""

    def __init__(self, fleet: FleetAccess, bus: Bus, keys: FleetKeys) -> None:
        self._fleet = fleet
        self._bus = bus
        self._keys = keys

    def find_end_utc(self, held: LeaseHold) -> str | None:
        """When a reservation ends by itself; None for a lease that its client renews, or that has no end."""
        left_ns = 0 if held.until_ns is None else held.until_ns - self._fleet.clock.now_ns()
        if left_ns <= SHOWN_FROM_NS:
            return None
        return format_utc(parse_utc(self._fleet.clock.utc()) + timedelta(microseconds=left_ns / NS_PER_US))

    def publish(self, held: LeaseHold, holder: str | None) -> None:
        """Publish what a lease has become. holder: of its axes now; None: they are free."""
        for controller, names in group_by_controller(held.axes).items():
            is_whole = set(names) == set(self._fleet.view.fleet.controllers[controller].axes)
            for axis in [None] if is_whole else names:
                lease = self.make_state(held, controller, axis, holder)
                self._bus.put(self._keys.lease(controller, axis), lease.to_json(), Priority.EVENT)

    def make_state(self, held: LeaseHold, controller: str, axis: str | None, holder: str | None) -> LeaseState:
        """The state of a controller, or of one of its axes."""
        return LeaseState(
            controller=controller,
            axis=axis,
            holder=holder,
            actor=held.actor,
            what=held.what,
            until_utc=self.find_end_utc(held),
            epoch=self._fleet.requests.leadership.epoch,
        )

    def make_free_state(self, controller: str) -> LeaseState:
        """The state of a controller without a lease."""
        return LeaseState(controller=controller, holder=None, actor="", epoch=self._fleet.requests.leadership.epoch)


class ServedLeases:
    """The keys `lease/{id}` of all controllers, of which `find_controllers` returns those of now: a `ServedGroup`."""

    def __init__(
        self, keys: FleetKeys, find_controllers: Callable[[], Collection[str]], handler: RequestHandler
    ) -> None:
        self._keys, self._find_controllers, self._handler = keys, find_controllers, handler

    def find_handler(self, key: str) -> RequestHandler | None:
        """What answers for the lease of a controller."""
        return self._handler if key.rpartition("/")[2] in self._find_controllers() else None

    def list_values(self) -> Iterable[str]:
        """The leases of all controllers."""
        return map(self._keys.lease, self._find_controllers())
