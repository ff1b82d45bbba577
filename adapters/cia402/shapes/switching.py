"""Outputs (60FEh) that the SYNCs of a stream switch: their levels travel with the positions, so they are planned by the
number of the SYNC that applies them, and an edge is known by when that SYNC was written and answered."""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil

from adapters.contract import HostInterval, SwitchedOutput


@dataclass(frozen=True, slots=True)
class SyncPoint:
    """An output. bit: in 60FEh. high: its level when active."""

    name: str
    bit: int
    high: bool

    def outputs_with(self, outputs: int, *, active: bool) -> int:
        """Return 60FEh with this output active or passive."""
        return outputs | self.bit if active == self.high else outputs & ~self.bit


@dataclass(frozen=True, slots=True)
class SwitchedPoint(SyncPoint):
    """An output with the numbers of the SYNCs that switch it: growing, the first to active, the last to passive. edges:
    those that were asked for. pulse: how many periods each of them lasts; 0: it changes the level."""

    numbers: tuple[int, ...]
    edges: tuple[int, ...] = ()
    pulse: int = 0

    def with_edges(self, edges: tuple[int, ...], point_count: int) -> "SwitchedPoint":
        """Return it with these edges. point_count: positions of the stream; a level is passive from the end on."""
        if self.pulse:
            numbers = tuple(number for edge in edges for number in (edge, edge + self.pulse))
        else:
            numbers = (*edges, max(point_count, edges[-1] + 1)) if len(edges) % 2 else edges
        return replace(self, numbers=numbers, edges=edges)


@dataclass(frozen=True, slots=True)
class OutputSchedule:
    """All outputs that a step switches."""

    points: tuple[SwitchedPoint, ...] = ()

    @property
    def last(self) -> int:
        """Return the number of the last SYNC that switches one; 0: none is switched."""
        return max((number for point in self.points for number in point.numbers[-1:]), default=0)

    def outputs_at(self, outputs: int, number: int) -> int:
        """Return 60FEh from SYNC `number` on. outputs: what the other outputs are."""
        for point in self.points:
            outputs = point.outputs_with(outputs, active=bool(bisect_right(point.numbers, number) % 2))
        return outputs

    def find_change(self, other: "OutputSchedule") -> int | None:
        """Return the number of the first SYNC that switches an output in one of the two only; None: there is none."""
        differences = [
            set(point.edges) ^ set(other_point.edges)
            for point, other_point in zip(self.points, other.points, strict=True)
        ]
        return min((min(numbers) for numbers in differences if numbers), default=None)

    def find_active(self, outputs: int) -> SwitchedPoint | None:
        """Return one of its outputs that is active already."""
        return next((point for point in self.points if outputs != point.outputs_with(outputs, active=False)), None)


NOTHING_SWITCHED = OutputSchedule()


@dataclass(frozen=True, slots=True)
class EdgeGrid:
    """Which SYNC switches an output for an instant: that whose effect is next to it. middle_ns: from SYNC to edge."""

    period_ns: int = 1
    middle_ns: int = 0

    def find_edges(self, instants_ns: Sequence[int]) -> list[int]:
        """Return the numbers of the SYNCs. The first SYNC is the start itself."""
        return [max(1, round((instant_ns - self.middle_ns) / self.period_ns)) for instant_ns in instants_ns]

    @property
    def most_off_ns(self) -> list[int]:
        """The SYNC of an instant behind the first one is between these distances from it."""
        half_ns = ceil(self.period_ns / 2)
        return [-half_ns - self.middle_ns, half_ns - self.middle_ns]


@dataclass(frozen=True, slots=True)
class EdgeTimes:
    """Bounds of an edge, ns: first_ns to last_ns after its SYNC was written, and at most after_ns after the drive's
    answer to that SYNC arrived."""

    first_ns: int
    last_ns: int
    after_ns: int


@dataclass(slots=True)
class EdgeLog:
    """What is known of the SYNCs of a stream. written: the number of the last one that was written; taken: the number
    of the last one whose positions the drive has certainly taken, by its answer to the next one. written_ns,
    answered_ns: by number, of SYNCs that switch an output."""

    schedule: OutputSchedule
    written: int = -1
    taken: int = -1
    written_ns: dict[int, int] = field(default_factory=dict[int, int])
    answered_ns: dict[int, int] = field(default_factory=dict[int, int])
    _numbers: frozenset[int] = field(init=False)

    def __post_init__(self) -> None:
        self.follow_schedule(self.schedule)

    def follow_schedule(self, schedule: OutputSchedule) -> None:
        """Record the edges of another schedule, which is the same for all SYNCs that have been written."""
        self.schedule = schedule
        self._numbers = frozenset(number for point in schedule.points for number in point.edges)

    def record_write(self, number: int, at_ns: int) -> None:
        self.written = number
        if number in self._numbers:
            self.written_ns[number] = at_ns

    def record_answer(self, number: int, at_ns: int) -> None:
        """Record an answer that shows that the drive has taken the positions of the SYNC before."""
        self.taken = max(self.taken, number - 1)
        if number in self._numbers:
            self.answered_ns[number] = at_ns

    def find_new_edges(self, times: EdgeTimes, known: Mapping[str, int]) -> dict[str, SwitchedOutput]:
        """Return what each output has done behind its first edges, whose numbers are in `known`."""
        new_edges: dict[str, SwitchedOutput] = {}
        for point in self.schedule.points:
            first = known.get(point.name, 0)
            end = bisect_right(point.edges, self.taken)
            new_edges[point.name] = SwitchedOutput([self._find_edge(edge, times) for edge in point.edges[first:end]])
        return new_edges

    def find_edges(self, times: EdgeTimes) -> dict[str, SwitchedOutput]:
        """Return what each output did, by name."""
        return {point.name: self._find_edges(point.edges, times) for point in self.schedule.points if point.edges}

    def _find_edges(self, numbers: Sequence[int], times: EdgeTimes) -> SwitchedOutput:
        edges = [self._find_edge(number, times) for number in numbers if number <= self.taken]
        # The SYNC after the last recorded one may have been written, too. Two edges are two SYNCs apart or more.
        return SwitchedOutput(edges, unknown=any(self.taken < number <= self.written + 1 for number in numbers))

    def _find_edge(self, number: int, times: EdgeTimes) -> HostInterval:
        written_ns, answered_ns = self.written_ns[number], self.answered_ns.get(number)
        latest_ns = written_ns + times.last_ns
        if answered_ns is not None:
            latest_ns = min(latest_ns, answered_ns + times.after_ns)
        return HostInterval(written_ns + times.first_ns, latest_ns)
