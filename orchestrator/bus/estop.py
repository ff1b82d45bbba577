"""The command to stop everything at once.

This module imports nothing but the bus: an e-stop from a shell waits for every module that is loaded before.
"""

import json

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.keys import ANY_ESTOP, FleetKeys


def put_estop(bus: Bus, fleet: str | None, event: str, actor: str, reason: str) -> None:
    """Make all receivers stop and latch; payload: `orchestrator.model.messages.EstopMessage`.

    fleet: None stops every fleet on the bus. Querying the fleets first would take time, two seconds if an adapter
    host hangs.
    """
    key = ANY_ESTOP if fleet is None else FleetKeys(fleet).estop
    bus.put(key, json.dumps({"event": event, "actor": actor, "reason": reason}).encode(), Priority.ESTOP)
