"""The keep-out zones as they are now, by the last states of the controllers."""

from orchestrator.coordinator.fleet.view import FleetView, find_answering_states
from orchestrator.model.messages import Request
from orchestrator.model.names import split_name
from orchestrator.model.operation.zone_state import ZoneState
from orchestrator.plan.zones.memory import ZoneMemory
from orchestrator.plan.zones.observation import observe_zones


class ZoneObserver:
    """Answers where bodies are, and what rules say to that."""

    def __init__(self, view: FleetView, memory: ZoneMemory) -> None:
        self._view = view
        self._memory = memory

    async def answer(self, request: Request) -> ZoneState:
        """The zones now; empty for a fleet without."""
        del request
        fleet = self._view.fleet
        if fleet.zones is None:
            return ZoneState()
        zones = self._memory.read(fleet)
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
