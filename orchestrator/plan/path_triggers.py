"""Triggers of a path in chunks: which of their instants belong to a chunk, in the time of its motion.

Positions are crossings of the path as planned. Its clock tells when a motion passes them, whatever rate that has.
Triggers in time are counted in the time of the motion, which does not go on while the path is held. A chunk has the
instants up to its end; what its stopping tail passes is switched only if the next chunk replaces the tail.
"""

from dataclasses import dataclass

import numpy as np

from orchestrator.clock.base import NS_PER_S
from orchestrator.plan.path_clock import PathClock
from orchestrator.plan.path_course import ChunkPlan
from orchestrator.plan.path_profiles import Array
from orchestrator.plan.step import StepPlan
from orchestrator.plan.triggers import MAX_CHUNKED_INSTANTS, ResolvedTrigger


@dataclass(frozen=True, slots=True)
class PathTrigger:
    """A trigger of a path, for a motion that begins at some place of it.

    marks_s: places of the path at which it switches, s of its time; of a trigger in time, instants that are stated.
    begun: how many of all are before the motion. elapsed_ns: how long the path was moved along before it.
    """

    resolved: ResolvedTrigger
    marks_s: Array
    begun: int
    elapsed_ns: int

    @classmethod
    def of(cls, resolved: ResolvedTrigger, whole: StepPlan, begun_s: float, elapsed_ns: int) -> "PathTrigger":
        """The trigger of a path. whole: its plan. begun_s: where on it the motion begins. Raises `Refusal`."""
        instants_ns = resolved.find_instants_ns(whole, MAX_CHUNKED_INSTANTS)
        marks_s = np.array([] if resolved.period_ns else instants_ns, dtype=np.float64) / NS_PER_S
        trigger = cls(resolved, marks_s, 0, elapsed_ns)
        return cls(resolved, marks_s, trigger.count_until(begun_s, 0), elapsed_ns)

    @property
    def least_ns(self) -> int:
        """The shortest time from one instant to the next at rate 1; 0: there is one at most."""
        if self.resolved.period_ns:
            return self.resolved.period_ns
        return round(float(np.diff(self.marks_s).min()) * NS_PER_S) if len(self.marks_s) > 1 else 0

    @property
    def gets_faster(self) -> bool:
        """Whether its instants follow faster where the path is played faster."""
        return self.resolved.axis is not None

    def find_most(self, within_s: float) -> int:
        """The most instants within so long, at rate 1."""
        if self.resolved.period_ns:
            return int(within_s * NS_PER_S // self.resolved.period_ns) + 1
        ends = np.searchsorted(self.marks_s, self.marks_s + within_s, side="right")
        return int((ends - np.arange(len(self.marks_s))).max(initial=0))

    def count_until(self, path_s: float, motion_ns: int) -> int:
        """How many are at a place of the path or before it, which the motion passes at `motion_ns` after T0."""
        if self.resolved.axis is not None:
            return int(np.searchsorted(self.marks_s, path_s, side="right"))
        if self.resolved.period_ns:
            return (self.elapsed_ns + motion_ns) // self.resolved.period_ns
        return int(np.searchsorted(self.marks_s * NS_PER_S, self.elapsed_ns + motion_ns + 0.5, side="right"))

    def find_instants_ns(self, first: int, end: int, clock: PathClock) -> list[int]:
        """When the motion passes those from number `first` to before `end`, ns from T0."""
        if self.resolved.period_ns:
            return [number * self.resolved.period_ns - self.elapsed_ns for number in range(first + 1, end + 1)]
        marks_s = self.marks_s[first:end]
        if self.resolved.axis is None:
            return [round(mark_s * NS_PER_S) - self.elapsed_ns for mark_s in marks_s.tolist()]
        return [round(at_s * NS_PER_S) for at_s in clock.find_instants(marks_s).tolist()]


class GivenTrigger:
    """What the owner of an output was given of a trigger in one motion along a path, chunk by chunk.

    instants_ns: from T0 on. skipped_ns: those that the motion has passed in its stopping tail, without switching.
    """

    def __init__(self, trigger: PathTrigger) -> None:
        self.trigger = trigger
        self._upto = trigger.begun
        # A level that the path was left with, when it was braked, is set again where it goes on.
        self._extra = 1 if trigger.resolved.pulse_ns == 0 and trigger.begun % 2 else 0
        self.instants_ns: list[int] = []
        self.skipped_ns: list[int] = []

    def find_part(self, chunk: ChunkPlan) -> tuple[int, list[int]]:
        """How many of the instants so far stay when this chunk is released, and those that it adds."""
        end = self._count_until(chunk, chunk.end_s)
        is_first = not self.instants_ns and self._upto == self.trigger.begun
        if end < self._upto:
            return end - self.trigger.begun + self._extra, []
        instants_ns = self.trigger.find_instants_ns(self._upto, end, chunk.clock)
        if is_first and self._extra:
            return 0, [0, *instants_ns]
        return len(self.instants_ns), instants_ns

    def take_part(self, chunk: ChunkPlan) -> None:
        """The chunk is released: its instants are given."""
        first, instants_ns = self.find_part(chunk)
        self.instants_ns[first:] = instants_ns
        self._upto = self._count_until(chunk, chunk.end_s)

    def skip_tail(self, chunk: ChunkPlan) -> None:
        """The motion comes to rest at the end of the chunk's tail."""
        end = max(self._upto, self._count_until(chunk, chunk.stop_s))
        self.skipped_ns = self.trigger.find_instants_ns(self._upto, end, chunk.clock)
        self._upto = end

    @property
    def remaining_count(self) -> int:
        """How many are left of those that are known ahead."""
        return max(0, len(self.trigger.marks_s) - self._upto)

    def _count_until(self, chunk: ChunkPlan, at_s: float) -> int:
        if chunk.last and self.trigger.resolved.axis is not None:
            return len(self.trigger.marks_s)
        return self.trigger.count_until(chunk.clock.find_path_s(at_s), round(at_s * NS_PER_S))
