"""Statistics of measured durations, and the noise of this machine."""

import asyncio
import math
from collections.abc import Sequence
from typing import NamedTuple, Self

from orchestrator.clock.live import raw_ns
from orchestrator.clock.owner import TaskOwner

NOISE_EVERY_S = 0.005


class DurationSpread(NamedTuple):
    """`n` durations in ms. asked: their target, in words; met: whether it is reached, where there is one."""

    n: int
    p50_ms: float
    p99_ms: float
    max_ms: float
    asked: str = ""
    met: bool | None = None


def make_spread(
    durations_ns: Sequence[int], p99_ms: float | None = None, max_ms: float | None = None
) -> DurationSpread:
    """Compute percentiles by nearest rank, with a target for the 99th or for the largest."""
    values = sorted(duration_ns / 1e6 for duration_ns in durations_ns)
    p50, p99 = (values[math.ceil(share * len(values)) - 1] for share in (0.5, 0.99))
    target, is_met = "", None
    if p99_ms is not None:
        target, is_met = f"p99 < {p99_ms:g} ms", p99 < p99_ms
    elif max_ms is not None:
        target, is_met = f"max < {max_ms:g} ms", values[-1] < max_ms
    return DurationSpread(
        n=len(values), p50_ms=round(p50, 3), p99_ms=round(p99, 3), max_ms=round(values[-1], 3), asked=target, met=is_met
    )


class WakeUpNoise:
    """Measures the wake-up delay of sleeping processes on this machine: no program on it can react more evenly."""

    def __init__(self) -> None:
        self._late_ns: list[int] = []
        self._tasks = TaskOwner()

    async def __aenter__(self) -> Self:
        self._tasks.spawn(self._sample_delays())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._tasks.cancel_all()

    def make_spread(self) -> DurationSpread:
        """Return the delays so far."""
        return make_spread(self._late_ns or [0])

    async def _sample_delays(self) -> None:
        while True:
            before_ns = raw_ns()
            await asyncio.sleep(NOISE_EVERY_S)
            self._late_ns.append(raw_ns() - before_ns - round(NOISE_EVERY_S * 1e9))
