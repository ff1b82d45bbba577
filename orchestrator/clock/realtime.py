"""Real-time priorities of Tutti's processes on busy processors, as far as the user may set them.

Otherwise processors are shared fairly, which is wrong for processes that move machines: an e-stop to 16 controllers,
on two processors that also arm others, reached the last axis within 10 ms at the median and 11 to 23 ms at most with
real-time priorities, and within 20 and 42 to 46 ms without (runs of some twenty). The user needs CAP_SYS_NICE or an
rtprio limit (`LimitRTPRIO=4` in a systemd unit). The kernel reserves a twentieth of every second for everything else
(`kernel.sched_rt_runtime_us`), so a runaway process can still be ended from a shell.
"""

import asyncio
import contextlib
import os
from enum import IntEnum

YIELD_S = 0.1


class RealtimePriority(IntEnum):
    """Real-time priorities, the lowest available: below everything else that a machine runs in real time."""

    SERVICE = 1
    """Coordinator and adapter hosts, which wait for each other's replies: with a lower priority for the coordinator,
    replies to `go` came too late for it on two busy processors."""
    BUS = 2
    """The router, and programs that send an e-stop: they have little to do, and all others wait for them. Also
    simulators, which stand in for hardware that needs no processor: at the priority of the hosts, they braked up
    to 20 ms too late."""
    GUARDIAN = 3
    """Must be able to end a runaway adapter host."""
    FIRING = 4
    """Sleeps except for the last two milliseconds before a start."""


def set_realtime_priority(priority: RealtimePriority, *, children: bool = True) -> bool:
    """Run this thread, and those that it starts later, at a real-time priority. Return whether that succeeded.

    An improvement, not a requirement: without permission, and outside of Linux, the priority stays as it is.
    children: processes and threads that this thread starts inherit the priority.
    """
    try:
        policy = os.SCHED_RR if children else os.SCHED_RR | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except (OSError, AttributeError):
        with contextlib.suppress(OSError, AttributeError):
            os.nice(-2 * priority)
        return False
    return True


def can_set_realtime_priority(priority: RealtimePriority) -> bool:
    """Return whether this user may set `priority`. Nothing changes."""
    try:
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
        os.sched_setscheduler(0, policy, parameters)
    except (OSError, AttributeError):
        return False
    return True


def yield_priority(priority: RealtimePriority) -> None:
    """Drop the real-time `priority` of this thread for a moment, so that urgent threads run; needs a running loop."""
    reset_priority()
    asyncio.get_running_loop().call_later(YIELD_S, set_realtime_priority, priority)


def reset_priority(pid: int = 0) -> None:
    """Return to the normal priority, though the parent has a higher one. pid: of another process; 0: this thread."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(pid, os.SCHED_OTHER, os.sched_param(0))
