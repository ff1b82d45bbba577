"""Stops of pairs that must not move on."""

from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.pairs import PairLoss, PairMonitor
from orchestrator.model.names import controller_of
from orchestrator.model.virtual_maps import Pair


class PairStops:
    """Stops both controllers of a pair that is lost, whatever moves them: a step, a jog, a homing, another client."""

    def __init__(self, access: FleetAccess, pairs: PairMonitor) -> None:
        self._access = access
        pairs.add_loss_listener(self._stop)

    def _stop(self, pair: Pair, loss: PairLoss) -> None:
        controllers = list(dict.fromkeys(map(controller_of, pair.real)))
        self._access.log.warning(f"{loss.text}: both are stopped; {loss.remedy}")
        stop = self._access.stop_members(controllers, "decelerate", "coordinator", loss.text)
        self._access.tasks.spawn(stop, vital=False)
