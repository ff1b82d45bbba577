"""The e-stops that other processes of the fleet keep, for a host that starts."""

import asyncio
from contextlib import suppress

from pydantic import ValidationError

from orchestrator.bus.base import Bus
from orchestrator.bus.keys import FleetKeys
from orchestrator.model.messages import KeptEstop
from orchestrator.model.state import ControllerState, EstopLatch

ASK_S = 1.0


async def find_kept_latches(bus: Bus, keys: FleetKeys) -> list[EstopLatch]:
    """Ask all processes that keep an e-stop, and all controllers that are served; what cannot be read is left out."""
    states, kept_estops = await asyncio.gather(
        bus.request_all(keys.state(), b"", ASK_S), bus.request_all(keys.kept_estop(), b"", ASK_S)
    )
    latches: list[EstopLatch | None] = []
    for key in sorted(kept_estops):
        with suppress(ValidationError):
            latches.append(KeptEstop.read_message(kept_estops[key]).estop)
    for key in sorted(states):
        with suppress(ValidationError):
            latches.append(ControllerState.read_message(states[key]).estop)
    return [latch for latch in latches if latch is not None]
