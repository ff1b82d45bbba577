"""The router as a process of its own: `python -m orchestrator.bus.zenoh.router ENDPOINT PARENT_PID [FLEET FILE]`.

Prints `ready` when it listens, and ends with SIGTERM, SIGINT or its parent. For a fleet it also keeps the e-stop latch,
in FILE: it runs on while everything else of a fleet restarts. Exit code 4: the endpoint is in use.
"""

import asyncio
import sys
from pathlib import Path

from orchestrator.bus.zenoh.kept_latch import keep_latch
from orchestrator.bus.zenoh.sessions import RouterRefused, open_router
from orchestrator.clock.owner import TaskOwner
from orchestrator.clock.parent import die_with_parent
from orchestrator.clock.process_limits import allow_open_files
from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority
from orchestrator.clock.signals import call_at_signals

EXIT_ENDPOINT_IN_USE = 4
MAX_FILES = 8192


def run_router(endpoint: str, parent_pid: int, latch: tuple[str, Path] | None = None) -> int:
    """Route until the end of the process; return its exit code. latch: the fleet whose e-stop latch is kept, and its
    file."""
    prepare_router_process()
    die_with_parent(parent_pid)
    try:
        asyncio.run(_route(endpoint, latch))
    except RouterRefused as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_ENDPOINT_IN_USE
    return 0


async def _route(endpoint: str, latch: tuple[str, Path] | None) -> None:
    ended_event = asyncio.Event()
    call_at_signals(ended_event.set)
    with open_router(endpoint):
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        keeping = TaskOwner(report_latch_end)
        if latch is not None:
            keeping.spawn(keep_latch(endpoint, latch[0], "router", latch[1]))
        await ended_event.wait()
        await keeping.end_all()


def report_latch_end(error: BaseException, _: bool) -> None:  # noqa: FBT001 - a callback
    """A latch that is not kept any more does not end the router."""
    sys.stderr.write(f"the router does not keep the e-stop latch: {error!r}\n")


def prepare_router_process() -> None:
    """Real-time priority, and as many open files as this user may have: each connection is one, also one that says
    nothing."""
    set_realtime_priority(RealtimePriority.BUS)
    allow_open_files(MAX_FILES)


if __name__ == "__main__":
    kept = (sys.argv[3], Path(sys.argv[4])) if sys.argv[3:] else None
    raise SystemExit(run_router(sys.argv[1], int(sys.argv[2]), kept))
