"""Profiles of any shape as contour records: position increments over equal times, straight between (L13907-13922).

A record lasts 2^n samples; the last ones may be shorter, so that a contour ends within a sample of its plan, or within
four where such short records can not be fed. All axes
of a contour share their instants. The plan is sampled at the controller's own sample instants, with rate and phase of
its clock in them, so that neither is left in the path.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from adapters.contract import CannotDo
from adapters.yaskawa.common.model import SPEED_UNIT, Model
from orchestrator.model.profile import Profile

LEAST_RECORDS = 3  # of full length: the program's way into its loop takes longer than a short record
SLACK = 0.5  # counts that an axis may still be from its target in the instant when its contour ends
PHASE = 0.5  # samples that a start may lie beside T0


@dataclass(frozen=True, slots=True)
class Room:
    """What limits a contour. elements: of the arrays, for all axes together. least_interval: smallest exponent that
    the program keeps up with. sag_counts: what a longer record may cost in between, for each axis."""

    elements: int
    least_interval: int
    sag_counts: float


@dataclass(frozen=True, slots=True)
class Contour:
    """The records of a contour, without their increments. Times in samples.

    interval: exponent of the first `records` ones. tail: exponents of the others, falling. ends: by axis, at which
    sample it has come to its target. sag_counts: by axis, how far the straight line of a record leaves the plan.
    """

    interval: int
    records: int
    tail: tuple[int, ...]
    ends: Mapping[str, int]
    sag_counts: Mapping[str, float]

    @property
    def count(self) -> int:
        return self.records + len(self.tail)

    @property
    def instants(self) -> list[int]:
        """The ends of all records."""
        ends: list[int] = []
        at = 0
        for exponent in [self.interval] * self.records + list(self.tail):
            at += 1 << exponent
            ends.append(at)
        return ends


def fit_contour(profiles: Mapping[str, Profile], tick_ns: float, room: Room, model: Model) -> Contour:
    """The shortest records that fit. Raises `CannotDo` naming axis and what would fit."""
    tick_s = tick_ns * 1e-9
    _require_speed(profiles, tick_s, model)
    each = room.elements // len(profiles)
    longest = max(profiles, key=lambda axis: profiles[axis].duration_s)
    for interval in range(max(room.least_interval, model.intervals[0]), model.intervals[1] + 1):
        sag_counts = {
            axis: profile.peak_acceleration * (tick_s * (1 << interval)) ** 2 / 8 for axis, profile in profiles.items()
        }
        worst = max(sag_counts, key=lambda axis: sag_counts[axis])
        if interval > room.least_interval and sag_counts[worst] > room.sag_counts:
            most_s = each * tick_s * (1 << (interval - 1))
            raise CannotDo(
                "contour-too-long",
                f"axis {longest}: {profiles[longest].duration_s:g} s need records of {1 << interval} samples, as the "
                f"arrays hold {each} for each of {len(profiles)} axes; axis {worst} would leave its plan by "
                f"{sag_counts[worst]:.1f} counts between them, allowed are {room.sag_counts:g}",
                f"at most {most_s:.1f} s, or fewer axes, or less acceleration, or raise contour_sag_counts",
            )
        _require_records(profiles, tick_s, interval, model)
        contour = _shape(profiles, tick_s, interval, sag_counts, model.least_tail)
        if contour.count <= each:
            return contour
    most_s = each * tick_s * (1 << model.intervals[1])
    raise CannotDo(
        "contour-too-long",
        f"axis {longest}: {profiles[longest].duration_s:g} s are longer than any contour of {len(profiles)} axes",
        f"at most {most_s:.0f} s; move in parts",
    )


def increments(profile: Profile, end: int, contour: Contour, phase: float, tick_ns: float) -> list[int]:
    """The increments of one axis, counts; their sum is exactly its way.

    end: its entry in `ends`. phase: samples from T0 to the sample in which the contour begins. At every instant the
    sum is the plan's rounded position, except that the last count waits for the record in which the axis ends.
    """
    way = profile.end_counts - profile.start_counts
    last = way - (1 if way > 0 else -1)
    tick_s = tick_ns * 1e-9
    at = profile.evaluator()
    steps: list[int] = []
    before = 0
    for instant in contour.instants:
        if instant >= end:
            here = way
        else:
            here = round(at((phase + instant) * tick_s).position)
            here = min(here, last) if way > 0 else max(here, last)
        steps.append(here - before)
        before = here
    return steps


def _shape(
    profiles: Mapping[str, Profile], tick_s: float, interval: int, sag_counts: Mapping[str, float], least_tail: int
) -> Contour:
    """The records that end with the longest profile, to half of the shortest one."""
    needed = {axis: _least_samples(profile, tick_s) for axis, profile in profiles.items()}
    total = max(needed.values())
    length = 1 << interval
    records, rest = divmod(-(-total >> least_tail) << least_tail, length)
    tail = tuple(n for n in range(interval - 1, least_tail - 1, -1) if rest >> n & 1)
    if records < LEAST_RECORDS:
        records, tail = LEAST_RECORDS, ()
    contour = Contour(interval, records, tail, {}, sag_counts)
    instants = contour.instants
    ends = {
        # Axes of one duration end together, wherever the last of them needs a sample more.
        axis: instants[-1] if least >= total - 1 else next(instant for instant in instants if instant >= least)
        for axis, least in needed.items()
    }
    return replace(contour, ends=ends)


def _least_samples(profile: Profile, tick_s: float) -> int:
    """After how many samples the axis can be at its target: when the plan is, or so nearly that nobody sees it."""
    duration = profile.duration_s / tick_s
    at, way = profile.evaluator(), profile.end_counts - profile.start_counts
    samples = max(math.ceil(duration - 1.0), 1)
    while samples < duration and abs(way - at((samples - PHASE) * tick_s).position) > SLACK:
        samples += 1
    return samples


def _require_speed(profiles: Mapping[str, Profile], tick_s: float, model: Model) -> None:
    most = model.speed_max / SPEED_UNIT / tick_s
    for axis, profile in profiles.items():
        if profile.peak_velocity > most:
            raise CannotDo(
                "too-fast", f"axis {axis}: {profile.peak_velocity:g} counts/s is too fast", f"at most {most:g} counts/s"
            )


def _require_records(profiles: Mapping[str, Profile], tick_s: float, interval: int, model: Model) -> None:
    """No increment beyond what a record can hold; a count for the rounding."""
    length_s = tick_s * (1 << interval)
    for axis, profile in profiles.items():
        if profile.peak_velocity * length_s + 2 > model.record_max:
            raise CannotDo(
                "record-range",
                f"axis {axis}: {profile.peak_velocity:g} counts/s are more than {model.record_max} counts in a record "
                f"of {length_s * 1e3:.2f} ms",
                f"at most {(model.record_max - 2) / length_s:.0f} counts/s",
            )


def least_interval(loop_ns: float, tick_ns: float, model: Model) -> int:
    """The exponent of the shortest record that lasts at least `loop_ns`."""
    low, high = model.intervals
    return next((n for n in range(low, high) if tick_ns * (1 << n) >= loop_ns), high)
