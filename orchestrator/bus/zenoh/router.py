"""The router as a process of its own: `python -m orchestrator.bus.zenoh.router ENDPOINT PARENT_PID`.

Prints `ready` when it listens, and ends with SIGTERM, SIGINT or its parent. Exit code 4: the endpoint is in use.
"""

import resource
import signal
import sys

from orchestrator.bus.zenoh.sessions import RouterRefused, open_router
from orchestrator.clock.parent import die_with_parent
from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority

EXIT_ENDPOINT_IN_USE = 4
MAX_FILES = 8192


def run_router(endpoint: str, parent_pid: int) -> int:
    _allow_connections()
    ends = {signal.SIGTERM, signal.SIGINT}
    # Blocked before Zenoh starts its threads, so that only `sigwait` receives them.
    signal.pthread_sigmask(signal.SIG_BLOCK, ends)
    die_with_parent(parent_pid)
    set_realtime_priority(RealtimePriority.BUS)
    try:
        with open_router(endpoint):
            sys.stdout.write("ready\n")
            sys.stdout.flush()
            signal.sigwait(ends)
    except RouterRefused as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_ENDPOINT_IN_USE
    return 0


def _allow_connections() -> None:
    """Raise the number of open files to what this user may have: each connection is one, also one that says nothing."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MAX_FILES if most == resource.RLIM_INFINITY else min(most, MAX_FILES)
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))


if __name__ == "__main__":
    raise SystemExit(run_router(sys.argv[1], int(sys.argv[2])))
