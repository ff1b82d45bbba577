"""Profiles of any shape as contour records: position increments over equal times, linear in between (L13907-13922).

A record lasts 2^n samples. The last records may be shorter, so that a contour ends within a sample of its plan, or
within four samples where the controller cannot be fed with such short records. All axes of a contour share their
instants. The plan is sampled at the controller's own sample instants, with rate and phase of its clock included, so
that neither adds a path error.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from adapters.yaskawa.shapes.model import SPEED_UNIT, ModelTraits
from orchestrator.model.errors import Refusal
from orchestrator.model.profile import Profile

FEWEST_RECORDS = 3  # of full length: the program takes longer to enter its loop than a short record lasts
END_TOLERANCE_COUNTS = 0.5  # counts by which an axis may still be off its target at the instant when its contour ends
MAX_PHASE_SAMPLES = 0.5  # samples by which a start may be off T0


@dataclass(frozen=True, slots=True)
class ContourLimits:
    """Limits of a contour.

    elements: of the arrays, for all axes together.
    least_interval: smallest exponent at which the program keeps up.
    sag_counts: largest deviation from the plan within a longer record, for each axis."""

    elements: int
    least_interval: int
    sag_counts: float


@dataclass(frozen=True, slots=True)
class Contour:
    """The records of a contour, without their increments. Times in samples.

    interval: exponent of the first `records` records.
    tail: exponents of the other records, descending.
    ends: by axis, the sample at which it has reached its target.
    sag_counts: by axis, the largest deviation of a record's straight line from the plan.
    """

    interval: int
    records: int
    tail: tuple[int, ...]
    ends: Mapping[str, int]
    sag_counts: Mapping[str, float]

    @property
    def record_count(self) -> int:
        return self.records + len(self.tail)

    @property
    def record_ends(self) -> list[int]:
        """Return the ends of all records."""
        ends: list[int] = []
        at = 0
        for exponent in [self.interval] * self.records + list(self.tail):
            at += 1 << exponent
            ends.append(at)
        return ends


def fit_contour(profiles: Mapping[str, Profile], tick_ns: float, room: ContourLimits, model: ModelTraits) -> Contour:
    """Return the contour with the shortest records that fit. Raises `Refusal` that names the axis and what would
    fit."""
    tick_s = tick_ns * 1e-9
    require_speed_range(profiles, tick_s, model)
    axis_elements = room.elements // len(profiles)
    longest = max(profiles, key=lambda axis: profiles[axis].duration_s)
    for interval in range(max(room.least_interval, model.intervals[0]), model.intervals[1] + 1):
        sag_counts = {
            axis: profile.peak_acceleration * (tick_s * (1 << interval)) ** 2 / 8 for axis, profile in profiles.items()
        }
        worst = max(sag_counts, key=lambda axis: sag_counts[axis])
        if interval > room.least_interval and sag_counts[worst] > room.sag_counts:
            most_s = axis_elements * tick_s * (1 << (interval - 1))
            raise Refusal(
                "contour-too-long",
                f"axis {longest}: {profiles[longest].duration_s:g} s need records of {1 << interval} "
                f"samples, because the arrays have {axis_elements} elements for each of {len(profiles)} axes; "
                f"between records axis {worst} would deviate from its plan by {sag_counts[worst]:.1f} "
                f"counts, allowed are {room.sag_counts:g}",
                f"at most {most_s:.1f} s, or fewer axes, or less acceleration, or raise contour_sag_counts",
            )
        require_record_range(profiles, tick_s, interval, model)
        contour = _build_records(profiles, tick_s, interval, sag_counts, model.least_tail)
        if contour.record_count <= axis_elements:
            return contour
    most_s = axis_elements * tick_s * (1 << model.intervals[1])
    raise Refusal(
        "contour-too-long",
        f"axis {longest}: {profiles[longest].duration_s:g} s exceed the longest contour of {len(profiles)} axes",
        f"at most {most_s:.0f} s; split the move",
    )


def axis_increments(profile: Profile, end: int, contour: Contour, phase: float, tick_ns: float) -> list[int]:
    """Return the increments of one axis in counts; their sum is exactly its path length.

    end: its entry in `ends`. phase: samples from T0 to the sample in which the contour begins. At every instant the sum
    is the rounded position of the plan, except that the last count is placed in the record in which the axis ends; not
    of an axis that turns back, which may be at its end, or beyond it, before.
    """
    way = profile.end_counts - profile.start_counts
    last, keeps_last = way - (1 if way > 0 else -1), profile.stays_between_ends
    tick_s = tick_ns * 1e-9
    at = profile.make_evaluator()
    steps: list[int] = []
    last_counts = 0
    for instant in contour.record_ends:
        if instant >= end:
            counts = way
        else:
            counts = round(at((phase + instant) * tick_s).position)
            if keeps_last:
                counts = min(counts, last) if way > 0 else max(counts, last)
        steps.append(counts - last_counts)
        last_counts = counts
    return steps


def _build_records(
    profiles: Mapping[str, Profile], tick_s: float, interval: int, sag_counts: Mapping[str, float], least_tail: int
) -> Contour:
    """Return the records that end with the longest profile, to half of the shortest record."""
    least_samples = {axis: _least_samples(profile, tick_s) for axis, profile in profiles.items()}
    total = max(least_samples.values())
    length = 1 << interval
    records, remainder = divmod(-(-total >> least_tail) << least_tail, length)
    tail = tuple(n for n in range(interval - 1, least_tail - 1, -1) if remainder >> n & 1)
    if records < FEWEST_RECORDS:
        records, tail = FEWEST_RECORDS, ()
    contour = Contour(interval, records, tail, {}, sag_counts)
    instants = contour.record_ends
    ends = {
        # Axes of equal duration end together, even if only the last of them needs one more sample.
        axis: instants[-1] if least >= total - 1 else next(instant for instant in instants if instant >= least)
        for axis, least in least_samples.items()
    }
    return replace(contour, ends=ends)


def _least_samples(profile: Profile, tick_s: float) -> int:
    """Return the number of samples after which the axis is at its target to within the tolerance
    `END_TOLERANCE_COUNTS`."""
    duration = profile.duration_s / tick_s
    at, way = profile.make_evaluator(), profile.end_counts - profile.start_counts
    samples = max(math.ceil(duration - 1.0), 1)
    while samples < duration and abs(way - at((samples - MAX_PHASE_SAMPLES) * tick_s).position) > END_TOLERANCE_COUNTS:
        samples += 1
    return samples


def require_speed_range(profiles: Mapping[str, Profile], tick_s: float, model: ModelTraits) -> None:
    """Raise `Refusal` for an axis that is faster than the controller."""
    most = model.speed_max / SPEED_UNIT / tick_s
    for axis, profile in profiles.items():
        if profile.peak_velocity > most:
            raise Refusal(
                "too-fast", f"axis {axis}: {profile.peak_velocity:g} counts/s is too fast", f"at most {most:g} counts/s"
            )


def require_record_range(profiles: Mapping[str, Profile], tick_s: float, interval: int, model: ModelTraits) -> None:
    """Raise `Refusal` for an increment that exceeds a record's range, with one count for rounding."""
    length_s = tick_s * (1 << interval)
    for axis, profile in profiles.items():
        if profile.peak_velocity * length_s + 2 > model.record_max:
            raise Refusal(
                "record-range",
                f"axis {axis}: {profile.peak_velocity:g} counts/s exceed {model.record_max} counts in a "
                f"record of {length_s * 1e3:.2f} ms",
                f"at most {(model.record_max - 2) / length_s:.0f} counts/s",
            )


def least_interval(loop_ns: float, tick_ns: float, model: ModelTraits) -> int:
    """Return the exponent of the shortest record that lasts at least `loop_ns`."""
    low, high = model.intervals
    return next((n for n in range(low, high) if tick_ns * (1 << n) >= loop_ns), high)
