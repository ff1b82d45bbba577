"""The start instant at which the members' ticks fall closest together.

A controller that starts at ticks of its own starts at the tick next to T0: up to half a tick beside it, and two of them
up to a tick apart. But T0 is free. Just behind the largest gap between the members' ticks they fall within a tick less
that gap; and because crystals differ, the phases drift (at 50 ppm by a tick in 20 s), so that a little later they may
fall closer still.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_AT_ONCE = 100_000  # ticks that are looked at in one piece
ENOUGH = 0.02  # of a tick: nobody waits for ticks that fall still closer together, which clocks could not tell anyway


@dataclass(frozen=True, slots=True)
class Grid:
    """Where a controller's ticks are: one of them at at_ns, fleet time, and the others tick_ns apart."""

    at_ns: int
    tick_ns: float


def closest(grids: Sequence[Grid], from_ns: int, within_ns: int) -> tuple[int, int]:
    """The instant, from `from_ns` on and not more than `within_ns` and two or three ticks later, about which one tick
    of each of `grids` lies closest; with the distance from the first of these ticks to the last, ns. The first such
    instant, if they come within `ENOUGH`: the sooner, the less will the clocks have gone astray until then."""
    if not grids:
        return from_ns, 0
    longest_ns = max(grid.tick_ns for grid in grids)
    first = grids[0]
    begin = int(np.ceil((from_ns - first.at_ns) / first.tick_ns))
    count = max(1, int(within_ns / first.tick_ns) + 1)
    best_ns, best_spread = float(from_ns), float("inf")
    for start in range(begin, begin + count, max(1, _AT_ONCE // len(grids))):
        ticks = np.arange(start, min(begin + count, start + max(1, _AT_ONCE // len(grids))))
        # Since from_ns, so that floats hold nanoseconds exactly.
        at = (first.at_ns - from_ns) + ticks * first.tick_ns
        phases = np.stack([np.mod((grid.at_ns - from_ns) - at, grid.tick_ns) for grid in grids], axis=1)
        phases.sort(axis=1)
        gaps = np.diff(phases, axis=1, append=phases[:, :1] + longest_ns)
        widest = gaps.argmax(axis=1)
        spreads = longest_ns - gaps.max(axis=1)
        close = spreads <= ENOUGH * longest_ns
        place = int(close.argmax()) if close.any() else int(spreads.argmin())
        if float(spreads[place]) < best_spread - 0.5:
            best_spread = float(spreads[place])
            # The ticks after the widest gap, which may be those of the next round.
            behind = (int(widest[place]) + 1) % len(grids)
            best_ns = from_ns + float(at[place]) + float(phases[place, behind]) + best_spread / 2
        if best_spread <= ENOUGH * longest_ns:
            break
    return round(best_ns), round(best_spread)
