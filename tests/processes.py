"""How processes that tests start find their signals."""

import signal
from types import FrameType

IGNORED_BY_SOME_PARENTS = (signal.SIGINT, signal.SIGHUP)


def _ignore(_: int, __: FrameType | None) -> None:
    """A process inherits that a signal is ignored, but no handler."""


def give_children_default_signals() -> None:
    """Every child that is started from now on, however it is started, has the default of SIGINT and SIGHUP, also where
    this process was started with them ignored, as under `nohup`, by cron, or as `make test &` in a script. This process
    itself goes on ignoring them then."""
    for number in IGNORED_BY_SOME_PARENTS:
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, _ignore)
