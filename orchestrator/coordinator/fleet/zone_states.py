"""The keep-out zones as they are now, by the last states of the controllers."""

from orchestrator.coordinator.fleet.view import FleetView, find_answering_states
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import Request
from orchestrator.model.names import split_name
from orchestrator.model.operation.zone_state import ZoneState
from orchestrator.plan.zones.observation import observe_zones
from orchestrator.plan.zones.rules import FleetZones


class ZoneObserver:
    """Answers where bodies are, and what rules say to that."""

    def __init__(self, view: FleetView) -> None:
        self._view = view
        self._made: tuple[Fleet, FleetZones] | None = None

    async def answer(self, request: Request) -> ZoneState:
        """The zones now; empty for a fleet without."""
        del request
        fleet = self._view.fleet
        if fleet.zones is None:
            return ZoneState()
        if self._made is None or self._made[0] is not fleet:
            self._made = fleet, FleetZones(fleet)
        zones = self._made[1]
        positions: dict[str, float] = {}
        unknown: dict[str, str] = {}
        states = find_answering_states(self._view, zones.ranges)
        for name in zones.ranges:
            controller, local = split_name(name)
            state = states.get(controller)
            if state is None or state.mode == "offline" or local not in state.axes:
                unknown[name] = "offline"
            elif not state.axes[local].referenced:
                unknown[name] = "not referenced"
            else:
                positions[name] = float(fleet.axis(name).to_position(state.axes[local].axis_counts))
        return observe_zones(fleet, zones, positions, unknown)
