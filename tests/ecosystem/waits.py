"""Waiting for an effect of another process, for which there is no event."""

import time
from collections.abc import Callable

LIMIT_S = 30.0
"""Generous: an event that takes longer does not occur."""


def wait_until(condition: Callable[[], object], limit_s: float = LIMIT_S) -> None:
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)
