"""Whether the router of a fleet serves new sessions."""

import time

from orchestrator.bus.zenoh.probe import probe_router
from orchestrator.runtime.doctor.findings import Finding

SLOW_S = 0.5


async def check_router(endpoint: str) -> Finding:
    """Open a session at the router, and close it."""
    began_s = time.monotonic()
    reason = await probe_router(endpoint)
    took_s = time.monotonic() - began_s
    if reason:
        return Finding("router", "failed", reason, "a router that accepts and never answers must be restarted")
    state = "warning" if took_s > SLOW_S else "ok"
    return Finding("router", state, f"{endpoint} answers in {took_s * 1e3:.0f} ms")
