"""Alarms of a process about its own place on the bus: a certificate that ends, a bus without TLS on a network."""

import asyncio
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from datetime import UTC, datetime

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.endpoint import describe_openness
from orchestrator.bus.expiry import describe_expiry, find_priority
from orchestrator.bus.identity import BadIdentity, find_identity, read_identity
from orchestrator.bus.keys import FleetKeys
from orchestrator.model.operation.alarms import AlarmRequest

REPEAT_S = 60.0  # an alarm that is not repeated for two minutes is over


def find_own_alarms(endpoint: str, now: datetime) -> list[AlarmRequest]:
    """What is to be raised now. endpoint: of the bus that the process uses."""
    found: list[AlarmRequest] = []
    if openness := describe_openness(endpoint):
        action = "let the router listen with TLS: `tutti keys`, `tutti router --keys`"
        found.append(
            AlarmRequest(kind="open-bus", subject="bus", text=openness, action=action, priority="high", active=True)
        )
    folder = find_identity()
    if folder is None or "tls/" not in endpoint:
        return found
    try:
        identity = read_identity(folder)
    except BadIdentity as error:
        # What runs goes on; it is its next start that would fail.
        action = "copy the whole folder again"
        found.append(AlarmRequest(kind="certificate", subject=folder.name, text=str(error), action=action, active=True))
        return found
    priority = find_priority(identity.expires, now)
    if priority is not None:
        name = identity.common_name
        text = f"the certificate of {name} {describe_expiry(identity.expires, now)}"
        text += f" ({identity.expires:%Y-%m-%d %H:%M} UTC)"
        action = f"`tutti keys renew {name.rpartition('.')[0]}`, copy its folder, restart it when the fleet is at rest"
        found.append(
            AlarmRequest(kind="certificate", subject=name, text=text, action=action, priority=priority, active=True)
        )
    return found


@asynccontextmanager
async def report_own_alarms(bus: Bus, keys: FleetKeys, source: tuple[str, str], endpoint: str) -> AsyncGenerator[None]:
    """Publish such alarms while the context lasts. source: role and id of the process."""
    reporting = asyncio.create_task(_report(bus, keys.alarm_request(*source), endpoint))
    try:
        yield
    finally:
        reporting.cancel()
        await asyncio.wait([reporting])


async def _report(bus: Bus, key: str, endpoint: str) -> None:
    while True:
        # A file is read, and a handshake made: not in the loop that stops axes.
        found: Sequence[AlarmRequest] = await asyncio.to_thread(find_own_alarms, endpoint, datetime.now(UTC))
        for each in found:
            bus.put(key, each.to_json(), Priority.EVENT)
        await asyncio.sleep(REPEAT_S)
