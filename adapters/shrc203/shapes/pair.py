"""Two-part moves through the prebuffer (L173-L181), where a single move cannot reproduce a requested duration.

Speeds are whole pulses/s and ramps at most a second, so that a single move of few pulses/s can have only some
durations: at 50 pls/s for 100 s they come in bands a second long and a second apart. Two moves at neighbouring speeds
share the path so that their durations add up. Between them the axis stands for the controller's hand-over, whose
duration is not in the manual. A timed wait between them (WT:, L215) would only add tenths of seconds.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import ceil, floor
from typing import NamedTuple

from adapters.shrc203.shapes.trapezoid import RAMP_MAX_MS, ShrcBounds, ShrcLeg, ShrcTrapezoid, start_speeds

FIRST_S = 1.0  # the follow-up move is loaded while the first one runs
# Ramps that are tried: smallest R in ms, and the fraction of F above the lowest start speed that they cover.
_RAMPS = ((0, 0.0), (500, 0.5), (950, 0.5), (950, 1.0))
_TRIED = 5  # values of a ramp's rise and time, from the smallest required ones
_GOOD_S = 20e-6  # among durations this near to the requested one, the path decides
_ENOUGH_S = 2e-6  # the search ends at a duration this near


@dataclass(frozen=True, slots=True)
class TwoPartMove:
    """Two moves with a pause between them."""

    first: ShrcTrapezoid
    second: ShrcTrapezoid
    gap_s: float

    @property
    def duration_s(self) -> float:
        return self.first.duration_s + self.gap_s + self.second.duration_s

    @property
    def motion_legs(self) -> tuple[ShrcLeg, ...]:
        return (*self.first.motion_legs, ShrcLeg(self.gap_s, 0.0, 0.0), *self.second.motion_legs)


class _RampChoice(NamedTuple):
    """Both ramps of a move. rise: F - S, pls/s. ms: R."""

    rise: int
    ms: int

    def lost_s(self, f: int) -> float:
        """Return how much longer a move takes with these ramps than at F from end to end: R (1 - S/F)."""
        return self.ms / 1000 * self.rise / f


def find_two_part_moves(distance: int, duration_s: float, bounds: ShrcBounds, gap_s: float) -> list[TwoPartMove]:
    """Return two-part moves within `bounds` for `distance` pls that take `duration_s`; if none does, the nearest, if
    any.

    They differ in the order of their speeds, in their ramps, and so in their path.
    """
    candidates = list(_search_moves(distance, duration_s - gap_s, bounds, gap_s))
    good = [pair for pair in candidates if abs(pair.duration_s - duration_s) <= _GOOD_S]
    return good or sorted(candidates, key=lambda pair: abs(pair.duration_s - duration_s))[:1]


def _search_moves(distance: int, moving_s: float, bounds: ShrcBounds, gap_s: float) -> Iterator[TwoPartMove]:
    if moving_s <= FIRST_S:
        return
    lowest, _, fastest = start_speeds(bounds)
    for kinds in product(_RAMPS, repeat=2):
        slow = _slower_speed(distance, moving_s, kinds, bounds)
        if not lowest <= slow < fastest:
            continue
        for speeds in ((slow + 1, slow), (slow, slow + 1)):
            ramps = tuple(_smallest_ramp(f, kind, bounds) for f, kind in zip(speeds, kinds, strict=True))
            pair = _tune_durations(distance, moving_s, speeds, ramps, bounds)
            if pair is not None and pair[0].duration_s >= FIRST_S:
                yield TwoPartMove(*pair, gap_s)


def _slower_speed(distance: int, moving_s: float, kinds: tuple[tuple[int, float], ...], bounds: ShrcBounds) -> int:
    """Return the whole speed below the one that is required outside these ramps; 0 when the ramps take all the time."""
    slow = floor(distance / moving_s)
    for _ in range(2):  # the time lost by the ramps depends on the speed in turn, but only slightly
        left_s = moving_s - sum(_smallest_ramp(slow + 1, kind, bounds).lost_s(slow + 1) for kind in kinds)
        slow = floor(distance / left_s) if left_s > 0 else 0
    return slow


def _smallest_ramp(f: int, ramp: tuple[int, float], bounds: ShrcBounds) -> _RampChoice:
    lowest, highest, _ = start_speeds(bounds)
    rise = max(f - highest, floor((f - lowest) * ramp[1]), 0)
    return _RampChoice(rise, max(_shortest_ms(rise, bounds), ramp[0]))


def _shortest_ms(rise: int, bounds: ShrcBounds) -> int:
    return max(1, ceil(rise / bounds.acceleration * 1000))


def _tune_durations(
    distance: int,
    moving_s: float,
    speeds: tuple[int, int],
    least: tuple[_RampChoice, ...],
    bounds: ShrcBounds,
) -> tuple[ShrcTrapezoid, ShrcTrapezoid] | None:
    """Return the two moves at these speeds, with at least these ramps, that are nearest to `moving_s`.

    The path is divided in whole pulses; the remainder is compensated by somewhat longer ramps, above all those of the
    faster move.
    """
    f1, f2 = speeds
    wanted_s = moving_s - least[0].lost_s(f1) - least[1].lost_s(f2)
    exact = (wanted_s - distance / f2) / (1 / f1 - 1 / f2)
    first = floor(exact) if f1 < f2 else ceil(exact)
    if not 1 <= first < distance:
        return None
    lost_s = moving_s - first / f1 - (distance - first) / f2
    quick, slow = (0, 1) if f1 > f2 else (1, 0)
    f = speeds[quick]
    best: tuple[_RampChoice, _RampChoice] | None = None
    error_s = float("inf")
    for longer_ramp in _longer_ramps(speeds[slow], least[slow], bounds):
        left_s = lost_s - longer_ramp.lost_s(speeds[slow])
        for rise in _ramp_rises(f, least[quick], bounds):
            ms = round(left_s * 1000 * f / rise) if rise else 1
            candidate = _RampChoice(rise, max(_shortest_ms(rise, bounds), min(RAMP_MAX_MS, ms)))
            off_s = abs(candidate.lost_s(f) - left_s)
            if off_s < error_s and candidate.ms <= RAMP_MAX_MS:
                best, error_s = (candidate, longer_ramp) if quick == 0 else (longer_ramp, candidate), off_s
        if error_s <= _ENOUGH_S:
            break
    if best is None:
        return None
    first_part, second_part = (
        ShrcTrapezoid(way, f - ramp.rise, f, ramp.ms)
        for way, f, ramp in zip((first, distance - first), speeds, best, strict=True)
    )
    return first_part, second_part


def _ramp_rises(f: int, least: _RampChoice, bounds: ShrcBounds) -> range:
    lowest, _, _ = start_speeds(bounds)
    return range(least.rise, min(least.rise + _TRIED, f - lowest + 1))


def _longer_ramps(f: int, least: _RampChoice, bounds: ShrcBounds) -> Iterator[_RampChoice]:
    for rise in _ramp_rises(f, least, bounds):
        shortest = max(least.ms, _shortest_ms(rise, bounds))
        for ms in range(shortest, min(shortest + _TRIED, RAMP_MAX_MS + 1)):
            yield _RampChoice(rise, ms)
