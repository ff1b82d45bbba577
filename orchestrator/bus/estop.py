"""The order to stop everything at once.

This module needs nothing but the bus: whoever gives the order from a shell waits for every module that is loaded first.
"""

import json

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.keys import ROOT, Keys


def put_estop(bus: Bus, fleet: str | None, event: str, actor: str, reason: str) -> None:
    """Have all that hear it stop and latch; payload: `orchestrator.model.messages.Estop`.

    fleet: None stops every fleet on the bus. To ask first which ones there are would take time, two seconds where an
    adapter host hangs.
    """
    key = f"{ROOT}/*/estop" if fleet is None else Keys(fleet).estop
    bus.put(key, json.dumps({"event": event, "actor": actor, "reason": reason}).encode(), Priority.ESTOP)
