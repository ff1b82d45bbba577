"""Whether the router of a fleet serves new sessions."""

from orchestrator.bus.zenoh.probe import probe_router
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.live import raw_ns
from orchestrator.runtime.doctor.findings import Finding

SLOW_MS = 500


async def check_router(endpoint: str) -> Finding:
    """Open a session at the router, and close it."""
    began_ns = raw_ns()
    reason = await probe_router(endpoint)
    took_ms = (raw_ns() - began_ns) // NS_PER_MS
    if reason:
        return Finding("router", "failed", reason, "a router that accepts and never answers must be restarted")
    state = "warning" if took_ms > SLOW_MS else "ok"
    return Finding("router", state, f"{endpoint} answers in {took_ms} ms")
