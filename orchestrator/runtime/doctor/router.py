"""Whether the router of a fleet serves new sessions, and whether other computers reach it without TLS."""

from contextlib import suppress

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusError
from orchestrator.bus.fleets import find_fleets
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.probe import probe_router
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.live import raw_ns
from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.monitor.open_bus import find_openness
from orchestrator.runtime.doctor.findings import Finding

SLOW_MS = 500
ANSWER_S = 2.0


async def check_router(endpoint: str) -> Finding:
    """Open a session at the router, and close it."""
    began_ns = raw_ns()
    reason = await probe_router(endpoint)
    took_ms = (raw_ns() - began_ns) // NS_PER_MS
    if reason:
        return Finding("router", "failed", reason, "a router that accepts and never answers must be restarted")
    state = "warning" if took_ms > SLOW_MS else "ok"
    return Finding("router", state, f"{endpoint} answers in {took_ms} ms")


async def check_openness(endpoint: str) -> Finding:
    """Whether other computers reach the bus without TLS, by the endpoint and by the alarms of its fleets. Raises
    `RouterUnreachable`."""
    bus = await open_bus(endpoint)
    try:
        openness = find_openness(endpoint, await list_alarms(bus))
    finally:
        await bus.close()
    if openness:
        return Finding("open bus", "warning", openness, "let it listen with TLS: `tutti keys`, `tutti router --keys`")
    return Finding("open bus", "ok", "no alarm that other computers reach the bus without TLS")


async def list_alarms(bus: Bus) -> list[AlarmRecord]:
    """The alarms of all fleets on a bus, as their leaders serve them; one that cannot be read is left out."""
    alarms: list[AlarmRecord] = []
    for fleet in await find_fleets(bus):
        with suppress(BusError):
            for payload in (await bus.request_all(FleetKeys(fleet).alarm(), b"", ANSWER_S)).values():
                with suppress(ValidationError):
                    alarms.append(AlarmRecord.read_message(payload))
    return alarms
