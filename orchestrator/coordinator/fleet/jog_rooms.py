"""The rooms in which axes of zones are jogged, by what stands around them."""

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

from orchestrator.coordinator.fleet.leases import TTL_MS, LeaseRegistry
from orchestrator.coordinator.fleet.zones import ZoneGuard
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import JogRoom
from orchestrator.plan.zones.rooms import Room

NOWHERE = 1e9
CLOSED = JogRoom(low=NOWHERE, high=-NOWHERE)
"""Of an axis whose place is not known, as while it moves. One without a reference is jogged by eye: its controller does
not know where its room is."""


class JogRooms:
    """Finds the rooms of leases for manual control, and finds them anew where axes of a lease have come to rest at
    other places.

    They hold whatever happens around them: what stood there when they were found may be moved afterwards, but counts
    with these axes as anywhere in their range then.
    """

    def __init__(self, zones: ZoneGuard, leases: LeaseRegistry) -> None:
        self._zones = zones
        self._leases = leases
        self._places: dict[str, Mapping[str, float | None]] = {}
        self._renewed: set[str] = set()

    def list_bound(self, axes: Collection[str]) -> list[str]:
        """Those of the axes that move bodies of zones."""
        return [axis for axis in self._zones.list_axes() if axis in axes]

    async def find(self, axes: Sequence[str], rooms: Mapping[str, JogRoom], holder: str) -> Mapping[str, JogRoom]:
        """The rooms of a new lease; of axes that are added to one they are closed until the next renewal. rooms: that
        it has already."""
        closed_rooms = dict.fromkeys(self.list_bound(axes), CLOSED)
        if rooms or not closed_rooms:
            return {**closed_rooms, **rooms}
        self._places[holder] = self._read_places(axes)
        return {**closed_rooms, **_make_rooms(await self._zones.find_rooms(axes, holder))}

    async def renew(self, axes: Sequence[str], holder: str) -> None:
        """Find the rooms of a lease anew, if its axes stand at other places than when they were found."""
        places = self._read_places(axes)
        if holder in self._renewed or not places or None in places.values() or self._places.get(holder) == places:
            return
        self._renewed.add(holder)
        try:
            rooms = _make_rooms(await self._zones.find_rooms(axes, holder))
            all_rooms = {**dict.fromkeys(places, CLOSED), **rooms}
            if places == self._read_places(axes) and await self._change_rooms(holder, all_rooms):
                self._places[holder] = places
        finally:
            self._renewed.discard(holder)

    async def _change_rooms(self, holder: str, rooms: Mapping[str, JogRoom]) -> bool:
        """Give the axes of a lease other rooms; return whether they have them: while one of them is being jogged, none
        of them changes.

        All places in the rooms of before are allowed together, and all in the new ones, but not those of one with those
        of the other. So first each axis is kept in both of its rooms.
        """
        leases, hold_before = self._leases, self._leases.find_lease(holder)
        if hold_before is None or hold_before.idle or hold_before.brief:
            return False
        both_rooms = {axis: room.narrow(hold_before.find_room(axis) or CLOSED) for axis, room in rooms.items()}
        async with hold_before.sending:  # a renewal with the rooms of before does not arrive in between
            try:
                kept_axes = await leases.send_lease(replace(hold_before, rooms=both_rooms), TTL_MS)
            except Refusal:
                return False
            hold = leases.find_lease(holder)
            if kept_axes or hold is None or hold.brief or hold.rooms is not hold_before.rooms:
                return False
            with suppress(Refusal):  # the next renewal brings them
                await leases.send_lease(leases.set_rooms(hold, rooms), TTL_MS)
        return True

    def forget(self, holder: str) -> None:
        """The lease of a holder is over."""
        self._places.pop(holder, None)

    def _read_places(self, axes: Collection[str]) -> Mapping[str, float | None]:
        """Where those of the axes are that zones depend on, in counts, by the last states; None: it moves, or is
        silent. One without a reference is nowhere."""
        places: dict[str, float | None] = {}
        for axis in self.list_bound(axes):
            state = self._zones.view.axis_now(axis)
            if state is None or state.moving or state.homing:
                places[axis] = None
            else:
                places[axis] = state.commanded_counts if state.referenced else NOWHERE
        return places


def _make_rooms(rooms: Mapping[str, Room]) -> dict[str, JogRoom]:
    return {axis: JogRoom(**room._asdict()) for axis, room in rooms.items()}
