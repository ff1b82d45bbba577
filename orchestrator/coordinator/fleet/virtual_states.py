"""The states of virtual axes, published as those of their real axes come."""

from collections.abc import Collection

from orchestrator.bus.base import Bus
from orchestrator.bus.keys import FleetKeys
from orchestrator.coordinator.fleet.lease_states import find_room
from orchestrator.coordinator.fleet.leases import LeaseRegistry
from orchestrator.coordinator.fleet.view import FleetView, find_answering_states
from orchestrator.model.messages import Request
from orchestrator.model.operation.virtual_state import VirtualState, VirtualStates, observe_group


class VirtualObserver:
    """Publishes each group of virtual axes when a controller of its real axes has published, or holds still."""

    def __init__(self, view: FleetView, bus: Bus, keys: FleetKeys, leases: LeaseRegistry) -> None:
        self._leases = leases
        self._view = view
        self._bus = bus
        self._keys = keys

    def start(self) -> None:
        """Publish from now on, until the view is closed."""
        self._view.add_arrival_listener(self._publish_groups)

    async def answer(self, request: Request) -> VirtualStates:
        """The states of all groups now."""
        del request
        return VirtualStates(groups=[self._observe(group) for group in self._view.fleet.virtual])

    def _publish_groups(self, controllers: Collection[str]) -> None:
        groups_of = self._view.fleet.virtual_axes.groups_of
        for group in dict.fromkeys(group for name in controllers for group in groups_of.get(name, ())):
            self._bus.put(self._keys.virtual(group), self._observe(group).to_json())

    def _observe(self, group: str) -> VirtualState:
        fleet = self._view.fleet
        states = find_answering_states(self._view, fleet.virtual_axes.maps[group].real)
        return observe_group(group, fleet, states, self._find_room)

    def _find_room(self, axis: str) -> tuple[float, float] | None:
        room = find_room(self._leases.all_leases, axis)
        return None if room is None else (room.low, room.high)
