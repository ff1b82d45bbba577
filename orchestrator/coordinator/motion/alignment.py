"""The start instant at which the members' ticks coincide best.

A controller that starts at its own ticks starts at the tick next to T0: up to half a tick away, and two controllers
up to a tick apart. But T0 can be chosen. Just after the largest gap between the members' ticks, all ticks lie within
a tick less that gap; and because crystals differ, the phases drift (at 50 ppm by a tick in 20 s), so that they may
coincide better a little later.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_CHUNK_TICKS = 100_000  # ticks that are evaluated in one piece
CLOSE_ENOUGH = 0.02  # of a tick: a closer coincidence is not worth waiting for; clock errors would hide it


@dataclass(frozen=True, slots=True)
class TickGrid:
    """The ticks of a controller: one at at_ns, fleet time, the others tick_ns apart."""

    at_ns: int
    tick_ns: float


def find_closest_ticks(grids: Sequence[TickGrid], from_ns: int, within_ns: int) -> tuple[int, int]:
    """Find the instant, from `from_ns` on and at most `within_ns` and two or three ticks later, around which one
    tick of each of `grids` lies closest; return it with the distance from the first of these ticks to the last,
    ns. The first such instant within `ENOUGH` is taken: the earlier, the smaller the clock error at it."""
    if not grids:
        return from_ns, 0
    longest_ns = max(grid.tick_ns for grid in grids)
    first = grids[0]
    begin = int(np.ceil((from_ns - first.at_ns) / first.tick_ns))
    count = max(1, int(within_ns / first.tick_ns) + 1)
    best_ns, best_spread = float(from_ns), float("inf")
    for start in range(begin, begin + count, max(1, _CHUNK_TICKS // len(grids))):
        ticks = np.arange(start, min(begin + count, start + max(1, _CHUNK_TICKS // len(grids))))
        # Relative to from_ns, so that floats represent nanoseconds exactly.
        at = (first.at_ns - from_ns) + ticks * first.tick_ns
        phases = np.stack([np.mod((grid.at_ns - from_ns) - at, grid.tick_ns) for grid in grids], axis=1)
        phases.sort(axis=1)
        gaps = np.diff(phases, axis=1, append=phases[:, :1] + longest_ns)
        widest = gaps.argmax(axis=1)
        spreads = longest_ns - gaps.max(axis=1)
        close = spreads <= CLOSE_ENOUGH * longest_ns
        index = int(close.argmax()) if close.any() else int(spreads.argmin())
        if float(spreads[index]) < best_spread - 0.5:
            best_spread = float(spreads[index])
            # The ticks after the widest gap, which may be those of the next period.
            next_grid = (int(widest[index]) + 1) % len(grids)
            best_ns = from_ns + float(at[index]) + float(phases[index, next_grid]) + best_spread / 2
        if best_spread <= CLOSE_ENOUGH * longest_ns:
            break
    return round(best_ns), round(best_spread)
