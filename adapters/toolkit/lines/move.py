"""One move of a controller with text lines, from its loading to its end."""

import asyncio
from dataclasses import dataclass
from math import ceil, floor

from adapters.contract import HostInterval, TimedWrite, WriteResult
from adapters.toolkit.lines.lowering import LineLowered
from adapters.toolkit.lines.options import LineOptions
from adapters.toolkit.lines.session import LineReply
from orchestrator.clock.base import NS_PER_S, NS_PER_US


@dataclass(slots=True)
class LineMove:
    """The loaded move. order: its timed write. started: the interval of its start."""

    lowered: LineLowered
    t0_ns: int
    stopped: bool = False
    running: "asyncio.Task[tuple[WriteResult, LineReply | None]] | None" = None
    order: TimedWrite | None = None
    started: HostInterval | None = None

    def rough_ends(self, now_ns: int) -> dict[str, HostInterval]:
        """Return when the axes have ended at the latest: now."""
        earliest_ns = self.t0_ns if self.started is None else self.started.earliest_ns
        span = HostInterval(min(earliest_ns, now_ns), now_ns)
        return dict.fromkeys(self.lowered.durations_s, span)

    def end_interval(self, options: LineOptions, duration_s: float, idle_ns: int) -> HostInterval:
        """Return the interval of an axis's end: its start and duration within the error of the crystal, and before the
        status that shows it at rest."""
        start_span = self.started
        assert start_span is not None
        margin = options.clock_ppm * 1e-6
        spread_ns = options.end_spread_us * NS_PER_US
        earliest_ns = start_span.earliest_ns + floor(duration_s * NS_PER_S * (1 - margin)) - spread_ns
        latest_ns = start_span.latest_ns + ceil(duration_s * NS_PER_S * (1 + margin)) + spread_ns
        latest_ns = min(latest_ns, idle_ns)
        return HostInterval(min(earliest_ns, latest_ns), latest_ns)
