"""Processes that must not outlive their parent process."""

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def die_with_parent(parent_pid: int) -> None:
    """Make the kernel send this process SIGTERM when its parent `parent_pid` ends, also by `kill -9`.

    Exits immediately if the parent has ended already. Linux only; elsewhere it does nothing.
    """
    if sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent_pid:
        raise SystemExit(1)


def prepare_worker(parent_pid: int) -> None:
    """Prepare a process of a pool: it ends with its parent, and silently on Ctrl-C."""
    die_with_parent(parent_pid)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
