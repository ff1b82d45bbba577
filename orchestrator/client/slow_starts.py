"""Adapter hosts that are slow to start: why a controller has no adapter for a while."""

import asyncio

from orchestrator.bus.base import Bus
from orchestrator.bus.keys import FleetKeys
from orchestrator.model.errors import Refusal

TOKENS_S = 0.3
"""For the presence that is announced already to arrive: it comes with the subscription, in milliseconds as a rule."""


async def explain_absence(bus: Bus, keys: FleetKeys, absent: Refusal) -> Refusal:
    """The refusal for a controller without an adapter, with the hosts that are starting slowly, if there are some.

    The client does not know which host has the controller: only the fleet file says that."""
    hosts: set[str] = set()

    def note_host(key: str, present: bool) -> None:  # noqa: FBT001 - a callback
        host = key.split("/")[-2]
        (hosts.add if present else hosts.discard)(host)

    declaration = await bus.watch(keys.slow_start(), note_host)
    try:
        await asyncio.sleep(TOKENS_S)
    finally:
        await declaration.undeclare()
    if not hosts:
        return absent
    text = f"{absent.text}; starting slowly: host {', '.join(sorted(hosts))}"
    remedy = "wait, if the controller is on that host: its computer is slow, or overloaded"
    return Refusal(absent.code, text, remedy, absent.controller)
