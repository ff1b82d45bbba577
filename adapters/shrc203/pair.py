"""Two moves one behind the other through the prebuffer (L173-L181), where one alone can not take a wanted time.

Speeds are whole pulses/s and ramps a second at the most, so that a single move of few pulses/s can have only some
durations: at 50 pls/s for 100 s they come in bands a second long and a second apart. Two moves at neighbouring speeds
share the way so that their times add up. Between them the axis stands for the unit's hand-over, whose time is not in
the manual. A timed standby between them (WT:, L215) would add nothing but tenths of seconds.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import ceil, floor
from typing import NamedTuple

from adapters.shrc203.trapezoid import RAMP_MAX_MS, Bounds, Leg, Trapezoid, start_speeds

FIRST_S = 1.0  # the second move is loaded while the first one runs
# Ramps that are tried: R in ms at least, and how much of what F is above the lowest start speed they climb.
_RAMPS = ((0, 0.0), (500, 0.5), (950, 0.5), (950, 1.0))
_TRIED = 5  # values of a ramp's rise and time, from the least that are wanted
_GOOD_S = 20e-6  # of durations so near to the wanted one the path decides
_ENOUGH_S = 2e-6  # nothing nearer is looked for


@dataclass(frozen=True, slots=True)
class Pair:
    """Two moves with a pause between them."""

    first: Trapezoid
    second: Trapezoid
    gap_s: float

    @property
    def duration_s(self) -> float:
        return self.first.duration_s + self.gap_s + self.second.duration_s

    @property
    def legs(self) -> tuple[Leg, ...]:
        return (*self.first.legs, Leg(self.gap_s, 0.0, 0.0), *self.second.legs)


class _Ramp(NamedTuple):
    """Both ramps of a move. rise: F - S, pls/s. ms: R."""

    rise: int
    ms: int

    def lost_s(self, f: int) -> float:
        """How much longer a move takes with these ramps than at F from end to end: R (1 - S/F)."""
        return self.ms / 1000 * self.rise / f


def pairs(distance: int, duration_s: float, bounds: Bounds, gap_s: float) -> list[Pair]:
    """Pairs within `bounds` for `distance` pls that take `duration_s`; if none does so well, the nearest, if any.

    They differ in which speed comes first, and in their ramps, and so in their way.
    """
    found = list(_found(distance, duration_s - gap_s, bounds, gap_s))
    good = [each for each in found if abs(each.duration_s - duration_s) <= _GOOD_S]
    return good or sorted(found, key=lambda each: abs(each.duration_s - duration_s))[:1]


def _found(distance: int, moving_s: float, bounds: Bounds, gap_s: float) -> Iterator[Pair]:
    if moving_s <= FIRST_S:
        return
    lowest, _, fastest = start_speeds(bounds)
    for kinds in product(_RAMPS, repeat=2):
        slow = _slow(distance, moving_s, kinds, bounds)
        if not lowest <= slow < fastest:
            continue
        for speeds in ((slow + 1, slow), (slow, slow + 1)):
            ramps = tuple(_least(f, kind, bounds) for f, kind in zip(speeds, kinds, strict=True))
            pair = _tuned(distance, moving_s, speeds, ramps, bounds, gap_s)
            if pair is not None and pair.first.duration_s >= FIRST_S:
                yield pair


def _slow(distance: int, moving_s: float, kinds: tuple[tuple[int, float], ...], bounds: Bounds) -> int:
    """The whole speed below the one that is needed outside these ramps; 0 when they take all the time."""
    slow = floor(distance / moving_s)
    for _ in range(2):  # what is lost with the ramps depends on the speed again, but little
        left_s = moving_s - sum(_least(slow + 1, kind, bounds).lost_s(slow + 1) for kind in kinds)
        slow = floor(distance / left_s) if left_s > 0 else 0
    return slow


def _least(f: int, ramp: tuple[int, float], bounds: Bounds) -> _Ramp:
    lowest, highest, _ = start_speeds(bounds)
    rise = max(f - highest, floor((f - lowest) * ramp[1]), 0)
    return _Ramp(rise, max(_shortest_ms(rise, bounds), ramp[0]))


def _shortest_ms(rise: int, bounds: Bounds) -> int:
    return max(1, ceil(rise / bounds.acceleration * 1000))


def _tuned(
    distance: int, moving_s: float, speeds: tuple[int, int], least: tuple[_Ramp, ...], bounds: Bounds, gap_s: float
) -> Pair | None:
    """The pair at these speeds, with at least these ramps, that is nearest to `moving_s`.

    The way is shared out by whole pulses; what that leaves is made up by somewhat longer ramps, above all those of the
    quicker move.
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
    best: tuple[_Ramp, _Ramp] | None = None
    error_s = float("inf")
    for other in _longer(speeds[slow], least[slow], bounds):
        left_s = lost_s - other.lost_s(speeds[slow])
        for rise in _rises(f, least[quick], bounds):
            ms = round(left_s * 1000 * f / rise) if rise else 1
            tried = _Ramp(rise, max(_shortest_ms(rise, bounds), min(RAMP_MAX_MS, ms)))
            off_s = abs(tried.lost_s(f) - left_s)
            if off_s < error_s and tried.ms <= RAMP_MAX_MS:
                best, error_s = (tried, other) if quick == 0 else (other, tried), off_s
        if error_s <= _ENOUGH_S:
            break
    if best is None:
        return None
    one, two = (
        Trapezoid(way, f - ramp.rise, f, ramp.ms)
        for way, f, ramp in zip((first, distance - first), speeds, best, strict=True)
    )
    return Pair(one, two, gap_s)


def _rises(f: int, least: _Ramp, bounds: Bounds) -> range:
    lowest, _, _ = start_speeds(bounds)
    return range(least.rise, min(least.rise + _TRIED, f - lowest + 1))


def _longer(f: int, least: _Ramp, bounds: Bounds) -> Iterator[_Ramp]:
    for rise in _rises(f, least, bounds):
        shortest = max(least.ms, _shortest_ms(rise, bounds))
        for ms in range(shortest, min(shortest + _TRIED, RAMP_MAX_MS + 1)):
            yield _Ramp(rise, ms)
