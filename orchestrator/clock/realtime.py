"""Which of Tutti's processes go first where the processors are busy, as far as the user may say so.

A processor is otherwise shared out fairly, which is wrong for what moves machines: an e-stop to 16 controllers, on two
processors that also arm others, came to the last axis within 10 ms at the median and 11 to 23 ms at the most with
real-time priorities, and within 20 and 42 to 46 ms without (runs of some twenty). The user needs CAP_SYS_NICE or an
rtprio limit for that (`LimitRTPRIO=4` in a systemd unit). The kernel leaves a twentieth of every second to everything
else (`kernel.sched_rt_runtime_us`), so that a process that runs wild can still be ended from a shell.
"""

import asyncio
import contextlib
import os
from enum import IntEnum

STEP_BACK_S = 0.1


class Urgency(IntEnum):
    """Real-time priorities, the lowest there are: below whatever else a machine runs in real time."""

    SERVICE = 1
    """Coordinator and adapter hosts, who wait for each other's answers: with the coordinator behind them, an answer to
    `go` came too late for it on two busy processors."""
    BUS = 2
    """The router, and who gives an e-stop: little to do, and everybody waits for it. And simulators, for they stand in
    for hardware, which waits for nobody's processor: as urgent as the hosts, they braked up to 20 ms too late."""
    GUARDIAN = 3
    """Must be able to end an adapter host that runs wild."""
    FIRING = 4
    """Sleeps but for the last two milliseconds before a start."""


def hurry(urgency: Urgency, children: bool = True) -> bool:
    """Run this thread, and those that it starts from now on, before whatever is less urgent; whether that is so.

    A help, not a need: where it is not allowed, and outside of Linux, all goes on as it is. children: processes and
    threads that this thread starts are as urgent.
    """
    try:
        policy = os.SCHED_RR if children else os.SCHED_RR | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(urgency))
    except (OSError, AttributeError):
        with contextlib.suppress(OSError):
            os.nice(-2 * urgency)
        return False
    return True


def may_hurry(urgency: Urgency) -> bool:
    """Whether this user may run what is of `urgency` before what is less urgent. Nothing changes."""
    try:
        policy, before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(urgency))
        os.sched_setscheduler(0, policy, before)
    except (OSError, AttributeError):
        return False
    return True


def step_back(urgency: Urgency) -> None:
    """Let whatever is urgent go before this thread, which is of `urgency`, for a moment; on a running loop."""
    calm()
    asyncio.get_running_loop().call_later(STEP_BACK_S, hurry, urgency)


def calm() -> None:
    """Be as urgent as any program, though the parent is more."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
