"""Whether a router serves new sessions."""

# Zenoh's type stubs omit many return types.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false

from functools import partial

from orchestrator.bus.zenoh.sessions import RouterUnreachable, open_session
from orchestrator.bus.zenoh.threads import run_in_thread

PROBE_TIMEOUT_S = 3.0


async def probe_router(endpoint: str, timeout_s: float = PROBE_TIMEOUT_S) -> str:
    """Open a session of its own and close it; return why that failed, "" if it did not."""
    try:
        session = await run_in_thread("router-probe", partial(open_session, endpoint, timeout_s))
    except RouterUnreachable as error:
        return str(error)
    await run_in_thread("router-probe", session.close)
    return ""
