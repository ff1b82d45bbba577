"""Positions of a drive as it sends them by itself: with TPDO 2, on every change, at most once in its inhibit time.

The drive takes the position when it sends the message, in a cycle of its own; the message then waits for the bus. The
position is from before its arrival, by no more than a cycle, the messages that may come first, and the delay on the way
into this computer.
"""

from collections.abc import Sequence

from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.costs import full_frame_ns
from adapters.cia402.options import Cia402Options
from adapters.contract import SampledPositions, SamplingPlan
from orchestrator.clock.base import NS_PER_MS, NS_PER_US
from orchestrator.model.errors import Refusal

PDOS = 4  # of each drive, which may be sent before this one
MOST_SAMPLES = 1_000_000  # in the memory of this computer


def find_arrival_delay_ns(options: Cia402Options, drives: int, bitrate: int) -> int:
    """How long before its arrival a position may have been taken. drives: on the bus."""
    return (options.cycle_us + options.wire_jitter_us) * NS_PER_US + PDOS * drives * full_frame_ns(bitrate)


class PdoSampling:
    """The samples of one drive. axis: its only axis."""

    def __init__(self, node: BusDrive, options: Cia402Options, axis: str) -> None:
        self._node, self._options, self._axis = node, options, axis

    def begin(self, period_ns: int, seconds: float) -> SamplingPlan:
        """Keep positions from now on. Raises `Refusal`."""
        least_ns = self._options.inhibit_ms * NS_PER_MS
        if period_ns < least_ns:
            raise Refusal(
                "sampling-period",
                f"a period of {period_ns / 1e6:g} ms is too short: the drive sends its position every "
                f"{self._options.inhibit_ms} ms",
                f"write a period of at least {self._options.inhibit_ms} ms, or a shorter `inhibit_ms` in its options",
            )
        if seconds * 1e9 / least_ns > MOST_SAMPLES:
            raise Refusal("sampling-space", f"{seconds:g} s are too long to be recorded", "split the move")
        self._node.positions = []
        return SamplingPlan(least_ns, 0)

    def take(self, drives: int, bitrate: int) -> SampledPositions:
        """End, and return what was kept. drives: on the bus. Raises `Refusal`."""
        positions, self._node.positions = self._node.positions, None
        if positions is None:
            raise Refusal("no-samples", "nothing is being recorded", "begin it first")
        before_ns = find_arrival_delay_ns(self._options, drives, bitrate)
        counts: Sequence[int] = [actual for _, actual in positions]
        return SampledPositions(
            [at_ns - before_ns // 2 for at_ns, _ in positions], before_ns // 2 + 1, {self._axis: counts}
        )
