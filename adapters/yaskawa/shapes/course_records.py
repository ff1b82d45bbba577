"""Records of a path in chunks: their place in the ring, their increments, and the controller's clock on the way.

Record n of the path ends `(n + 1) << interval` samples after its begin. Which instant of the plan that is follows from
the clock mapping of the chunk: what the clock has drifted since the chunk before is spread over the new one, so that no
speed jumps. A chunk's records follow those of the one before in the ring; its stopping tail lies behind the ring, in
one of two places in turn, so that the tail in force stays as it is until the chunk is released.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from adapters.contract import ChunkFit, PathChunk
from adapters.yaskawa.shapes.model import ModelTraits
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.profile import Profile

LONGEST_CHUNK_S = 7.5
LONGEST_TAIL_S = 3.3  # a little more than the longest ramp that is planned
LEAST_RING = 256  # records
SPARE_RECORDS = 4  # of the ring, between what is played and what is loaded
MOST_CORRECTION = 200e-6  # of the speed


class RingRoom(NamedTuple):
    """Elements of each array: a ring, a power of two, and two tails behind it."""

    ring: int
    tail: int

    @property
    def elements(self) -> int:
        """Of one array."""
        return self.ring + 2 * self.tail

    def tail_begin(self, slot: int) -> int:
        """The first element of a tail."""
        return self.ring + slot * self.tail


def find_room(elements: int, axes: int, record_s: float) -> RingRoom:
    """The room in the arrays of `axes` axes, `elements` in all, for records of `record_s`: for two of the longest
    chunks, or for shorter ones. Raises `Refusal`."""
    tail = math.ceil(LONGEST_TAIL_S / record_s)
    ring = LEAST_RING
    while ring < 2 * LONGEST_CHUNK_S / record_s + SPARE_RECORDS:
        ring *= 2
    while axes * (ring + 2 * tail) > elements and ring > LEAST_RING:
        ring //= 2
    if axes * (ring + 2 * tail) > elements:
        text = f"a path of {axes} axes needs {axes * (ring + 2 * tail)} array elements; there are {elements}"
        raise Refusal("array-space", text, "raise the controller's option array_elements")
    return RingRoom(ring, tail)


def find_chunk_s(room: RingRoom, record_s: float) -> float:
    """The longest chunk, with its tail, that can be loaded while one as long is played, s."""
    return min(LONGEST_CHUNK_S, (room.ring // 2 - SPARE_RECORDS) * record_s)


class RecordTimes(NamedTuple):
    """The instant of the plan at which a record begins: `first_s` at `first`, and `record_s` more for each further
    one."""

    first: int
    first_s: float
    record_s: float

    def time_s(self, record: float) -> float:
        """When this record begins, in seconds after T0."""
        return self.first_s + (record - self.first) * self.record_s

    def last_before(self, time_s: float) -> int:
        """The last record that begins at `time_s` or before."""
        return self.first + math.floor((time_s - self.first_s) / self.record_s + 1e-9)


class LoadedPart(NamedTuple):
    """Elements of all arrays from `first` on, by index of the axis."""

    first: int
    values: Mapping[int, list[int]]


@dataclass(frozen=True, slots=True)
class ChunkRecords:
    """A chunk as records: `first` to before `end` in the ring, then a tail.

    times: of the records. counts: by index of the axis, where it is at the beginning of records `first` to `end`,
    counts from the start of the path. full: records of full length of the tail; short: exponents of the others. parts:
    what is to be loaded. stop_s: when it is at rest. targets: there, by index, absolute counts. before: the chunk that
    it follows, which may still be executed.
    """

    number: int
    first: int
    end: int
    times: RecordTimes
    counts: Mapping[int, list[int]]
    slot: int
    full: int
    short: tuple[int, ...]
    parts: tuple[LoadedPart, ...]
    stop_s: float
    targets: Mapping[int, int]
    before: "ChunkRecords | None" = None
    fit: ChunkFit = field(default_factory=lambda: ChunkFit(0.0, 0, 0, 0, {}))

    def samples(self, interval: int) -> int:
        """Samples from the begin of the path to its end, if no further chunk comes."""
        return (self.end + self.full << interval) + sum(1 << exponent for exponent in self.short)

    def tail_variables(self, room: RingRoom) -> dict[str, int]:
        """The program's variables of the tail."""
        begin = room.tail_begin(self.slot)
        return {"XTB": begin, "XV": begin + self.full, "XM": begin + self.full + len(self.short)}


@dataclass(frozen=True, slots=True)
class RecordMaker:
    """Makes the records of chunks for one path. axes: index by name. interval: exponent of a record."""

    axes: Mapping[str, int]
    interval: int
    room: RingRoom
    model: ModelTraits

    def make_first(self, chunk: PathChunk, phase: float, tick_ns: float) -> ChunkRecords:
        """The first chunk, for a begin `phase` samples after T0."""
        record_s = (tick_ns * (1 << self.interval)) / NS_PER_S
        times = RecordTimes(0, phase * tick_ns / NS_PER_S, record_s)
        return self._make(chunk, times, 0, dict.fromkeys(self.axes.values(), 0), slot=0)

    def make_next(
        self, chunk: PathChunk, before: ChunkRecords, mapping: TickMapping, begun: "BegunPath"
    ) -> ChunkRecords:
        """The chunk behind `before`, which is being executed: from its end, or from a record inside it where the chunk
        ends before that. Raises `Refusal`."""
        old = before.times
        if chunk.end_s < old.time_s(before.end):
            return self._cut_short(chunk, before)
        first, at_s = before.end, old.time_s(before.end)
        if at_s < chunk.begin_s - old.record_s * 1e-6:
            raise Refusal("gap", f"the chunk begins at {chunk.begin_s:.4f} s; the one before ends at {at_s:.4f} s", "")
        true_s = (mapping.to_host_ns(begun.tick + (first << self.interval)) - begun.t0_ns) / NS_PER_S
        record_s = mapping.tick_ns * (1 << self.interval) / NS_PER_S
        drift_s, way_s = true_s - at_s, max(chunk.end_s - at_s, record_s)
        part = min(max(drift_s / way_s, -MOST_CORRECTION), MOST_CORRECTION)
        times = RecordTimes(first, at_s, record_s * (1 + part))
        held_counts = {index: counts[-1] for index, counts in before.counts.items()}
        new_records = self._make(chunk, times, first, held_counts, slot=1 - before.slot)
        left_ns = round((drift_s - part * way_s) * NS_PER_S)
        bound_ns = mapping.bound_at_ns(round(begun.t0_ns + at_s * NS_PER_S))
        fit = replace(new_records.fit, drift_ns=round(drift_s * NS_PER_S), left_ns=left_ns, bound_ns=bound_ns)
        return replace(new_records, fit=fit, before=replace(before, before=None))

    def _cut_short(self, chunk: PathChunk, before: ChunkRecords) -> ChunkRecords:
        """A tail from a record inside what is released on. Raises `Refusal`."""
        part = before
        if before.before is not None and chunk.end_s < before.times.time_s(before.first + 1):
            part = before.before
        end = part.times.last_before(chunk.end_s)
        if not part.first < end < before.end:
            raise Refusal("late", "the place where the path is to be braked is executed already", "")
        held_counts = {index: counts[end - part.first] for index, counts in part.counts.items()}
        kept_counts = {index: counts[: end - part.first + 1] for index, counts in part.counts.items()}
        return replace(self._make_tail(chunk, replace(part, end=end), held_counts, 1 - before.slot), counts=kept_counts)

    def _make(
        self, chunk: PathChunk, times: RecordTimes, first: int, held: Mapping[int, int], slot: int
    ) -> ChunkRecords:
        # The last record of full length of a path belongs to its end.
        end = times.last_before(chunk.end_s) - (1 if chunk.last else 0)
        if end <= first:
            raise Refusal("short-chunk", f"chunk {chunk.number} of the path is shorter than two records", "")
        instants = [times.time_s(record) for record in range(first, end + 1)]
        counts = {
            index: [held[index], *_find_positions(chunk.profiles[name], chunk.begin_s, instants[1:])]
            for name, index in self.axes.items()
        }
        records = ChunkRecords(
            number=chunk.number,
            first=first,
            end=end,
            times=times,
            counts=counts,
            slot=slot,
            full=0,
            short=(),
            parts=(),
            stop_s=0.0,
            targets={},
        )
        whole_records = self._make_tail(
            chunk, records, {index: axis_counts[-1] for index, axis_counts in counts.items()}, slot
        )
        return replace(whole_records, parts=(*self._place_in_ring(counts, first), *whole_records.parts))

    def _make_tail(self, chunk: PathChunk, records: ChunkRecords, held: Mapping[int, int], slot: int) -> ChunkRecords:
        """The records from `records.end` to rest."""
        times, interval = records.times, self.interval
        tick_s = times.record_s / (1 << interval)
        samples = max(math.ceil((chunk.stop_s - times.time_s(records.end)) / tick_s - 0.5), 1)
        if chunk.last:
            samples = -(-samples >> self.model.least_tail) << self.model.least_tail
            full, remainder = max(1, samples >> interval), samples & (1 << interval) - 1
            short = tuple(n for n in range(interval - 1, self.model.least_tail - 1, -1) if remainder >> n & 1)
            short = short if samples >> interval else ()
        else:
            full, short = -(-samples >> interval), ()
        if full + len(short) > self.room.tail:
            raise Refusal("long-tail", f"the stopping tail of chunk {chunk.number} takes {full} records", "")
        ends = [records.end + k for k in range(1, full + 1)]
        instants = [times.time_s(record) for record in ends]
        for exponent in short:
            instants.append(instants[-1] + times.record_s / (1 << interval - exponent))
        targets: dict[int, int] = {}
        values: dict[int, list[int]] = {}
        for name, index in self.axes.items():
            profile = chunk.profiles[name]
            way = profile.end_counts - profile.start_counts
            positions = [*_find_positions(profile, chunk.begin_s, instants[:-1]), way]
            values[index] = _find_steps(held[index], positions)
            targets[index] = profile.end_counts
        room = self.room.tail_begin(slot)
        record_s = times.record_s
        errors = {name: 1.0 + p.peak_acceleration * record_s**2 / 8 for name, p in chunk.profiles.items()}
        return replace(
            records,
            number=chunk.number,
            slot=slot,
            full=full,
            short=short,
            parts=(LoadedPart(room, values),),
            stop_s=instants[-1],
            targets=targets,
            fit=ChunkFit(instants[-1], 0, 0, 0, errors),
        )

    def _place_in_ring(self, counts: Mapping[int, list[int]], first: int) -> tuple[LoadedPart, ...]:
        """The increments of records from `first` on, in one part or, around the end of the ring, two."""
        steps = {index: _find_steps(axis_counts[0], axis_counts[1:]) for index, axis_counts in counts.items()}
        at = first % self.room.ring
        split = self.room.ring - at
        parts = [LoadedPart(at, {index: axis_steps[:split] for index, axis_steps in steps.items()})]
        if any(len(axis_steps) > split for axis_steps in steps.values()):
            parts.append(LoadedPart(0, {index: axis_steps[split:] for index, axis_steps in steps.items()}))
        return tuple(parts)


@dataclass(frozen=True, slots=True)
class BegunPath:
    """The begin of a path: the sample in which its first record begins, and T0, host time."""

    tick: int
    t0_ns: int


def _find_positions(profile: Profile, begin_s: float, instants: list[float]) -> list[int]:
    """Where an axis is at instants after T0, counts from the start of the path."""
    at = profile.make_evaluator()
    return [round(at(instant - begin_s).position) for instant in instants]


def _find_steps(held: int, positions: list[int]) -> list[int]:
    return [position - old_position for old_position, position in zip([held, *positions], positions, strict=False)]
