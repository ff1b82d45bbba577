"""Alarms of a process about its own place on the bus: a certificate that ends, a bus without TLS on a network."""

import asyncio
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from datetime import UTC, datetime

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.endpoint import describe_openness
from orchestrator.bus.expiry import describe_expiry, find_priority
from orchestrator.bus.fleets import find_fleets
from orchestrator.bus.identity import BadIdentity, find_identity, read_identity
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.sessions import RouterUnreachable
from orchestrator.clock.owner import TaskOwner
from orchestrator.model.operation.alarms import OPEN_BUS, AlarmRequest

REPEAT_S = 60.0  # an alarm that is not repeated for two minutes is over
ROUTER_REPEAT_S = 5.0  # a coordinator that starts behind the router has it soon


def find_own_alarms(endpoint: str, now: datetime) -> list[AlarmRequest]:
    """What is to be raised now. endpoint: of the bus that the process uses."""
    openness = describe_openness(endpoint)
    alarms = [_make_open_bus(openness)] if openness else []
    folder = find_identity()
    if folder is None or "tls/" not in endpoint:
        return alarms
    try:
        identity = read_identity(folder)
    except BadIdentity as error:
        # What runs goes on; it is its next start that would fail.
        action = "copy the whole folder again"
        alarms.append(
            AlarmRequest(kind="certificate", subject=folder.name, text=str(error), action=action, active=True)
        )
        return alarms
    priority = find_priority(identity.expires, now)
    if priority is not None:
        name = identity.common_name
        text = f"the certificate of {name} {describe_expiry(identity.expires, now)}"
        text += f" ({identity.expires:%Y-%m-%d %H:%M} UTC)"
        action = f"`tutti keys renew {name.rpartition('.')[0]}`, copy its folder, restart it when the fleet is at rest"
        alarms.append(
            AlarmRequest(kind="certificate", subject=name, text=text, action=action, priority=priority, active=True)
        )
    return alarms


async def report_open_router(endpoint: str, listen: str, fleet: str, name: str) -> None:
    """Publish that a router listens without TLS where other computers reach it, until cancelled: a process on its
    computer uses another endpoint, and does not know. endpoint: of its own session. fleet: "": each one on its bus."""
    if not (openness := describe_openness(listen)):
        return
    while True:
        try:
            bus = await open_bus(endpoint)
        except RouterUnreachable:
            await asyncio.sleep(ROUTER_REPEAT_S)
            continue
        try:
            while True:
                for fleet_name in [fleet] if fleet else await find_fleets(bus):
                    request = _make_open_bus(openness)
                    bus.put(FleetKeys(fleet_name).alarm_request("router", name), request.to_json(), Priority.EVENT)
                await asyncio.sleep(ROUTER_REPEAT_S)
        finally:
            await bus.close()


def _make_open_bus(openness: str) -> AlarmRequest:
    action = "let the router listen with TLS: `tutti keys`, `tutti router --keys`"
    return AlarmRequest(kind=OPEN_BUS, subject="bus", text=openness, action=action, priority="high", active=True)


@asynccontextmanager
async def report_own_alarms(bus: Bus, keys: FleetKeys, source: tuple[str, str], endpoint: str) -> AsyncGenerator[None]:
    """Publish such alarms while the context lasts. source: role and id of the process."""
    reporting = TaskOwner()
    reporting.spawn(_report(bus, keys.alarm_request(*source), endpoint))
    try:
        yield
    finally:
        await reporting.end_all()


async def _report(bus: Bus, key: str, endpoint: str) -> None:
    while True:
        # A file is read, and a handshake made: not in the loop that stops axes.
        requests: Sequence[AlarmRequest] = await asyncio.to_thread(find_own_alarms, endpoint, datetime.now(UTC))
        for request in requests:
            bus.put(key, request.to_json(), Priority.EVENT)
        await asyncio.sleep(REPEAT_S)
