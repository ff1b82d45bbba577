"""The true motion of simulated axes, as their profile generators made it: not visible to any part of the fleet."""

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.fleet import Axis
from orchestrator.testing.errors import BadTest, format_s
from sim.core.controller import CommandedMotion, SimulatedController

SAMPLE_NS = 10 * NS_PER_MS
"""Between two samples. The cubic between them is off by at most a/64 of this time squared where the acceleration
changes by a at once: by 1.6 µm for 1 m/s²."""
IDLE_SAMPLES = 5  # of an axis at rest only one in so many is taken: its position changes only when it is set


@dataclass(frozen=True, slots=True)
class TrueMove:
    """One commanded motion of an axis. Slow ones of some makes consist of several.

    start_s, end_s: in fleet time, s; end_s is None while it runs. from_position, to_position: in the axis's unit.
    """

    start_s: float
    end_s: float | None
    from_position: float
    to_position: float | None


class _Sample(NamedTuple):
    """Commanded position and velocity of a motor at an instant, host ns, in counts of the make."""

    at_ns: int
    counts: float
    counts_per_s: float


class MotorRecord:
    """The course of one motor: samples, and the exact begins and ends of its motions."""

    def __init__(self, controller: SimulatedController, motor: str) -> None:
        self._controller = controller
        self._motor = motor
        self._samples: list[_Sample] = []
        self._seen = 0  # motions of the whole controller
        self._running: list[CommandedMotion] = []
        self._skipped = 0

    @property
    def motions(self) -> list[CommandedMotion]:
        """All its motions so far."""
        return [motion for motion in self._controller.commanded_motions if motion.axis == self._motor]

    def take_sample(self, now_ns: int) -> None:
        """Record the present position, and what has begun and ended since the last sample."""
        motions = self._controller.commanded_motions
        self._skipped = 0 if self._running or self._seen < len(motions) else (self._skipped + 1) % IDLE_SAMPLES
        if self._skipped:
            return
        edges: list[_Sample] = []
        while self._seen < len(motions) and motions[self._seen].start_ns <= now_ns:
            motion = motions[self._seen]
            self._seen += 1
            if motion.axis == self._motor:
                self._running.append(motion)
                edges.append(_Sample(motion.start_ns, motion.start_counts, 0.0))
        for motion in [
            candidate for candidate in self._running if candidate.end_ns is not None and candidate.end_ns <= now_ns
        ]:
            self._running.remove(motion)
            if motion.end_ns is not None and motion.end_counts is not None:
                edges.append(_Sample(motion.end_ns, motion.end_counts, 0.0))
        for edge in sorted(edges):
            if not self._samples or edge.at_ns > self._samples[-1].at_ns:
                self._samples.append(edge)
        velocity = self._controller.velocity(self._motor) if self._running else 0.0
        self._append(_Sample(now_ns, self._controller.position(self._motor), velocity))

    def _append(self, sample: _Sample) -> None:
        """Append a sample; of a time at rest only the first and the last one are kept."""
        last_two = self._samples[-2:]
        if last_two and last_two[-1].at_ns == sample.at_ns:
            return
        if len(last_two) == 2 and all(
            last_sample[1:] == sample[1:] and not last_sample.counts_per_s for last_sample in last_two
        ):
            self._samples[-1] = sample
        else:
            self._samples.append(sample)

    def find_counts(self, at_ns: int) -> float:
        """The position at an instant, host ns, in counts of the make; that of the first sample before it."""
        number = bisect_right(self._samples, at_ns, key=lambda sample: sample.at_ns)
        if number == 0 or number == len(self._samples):
            return self._samples[min(number, len(self._samples) - 1)].counts
        return _interpolate(self._samples[number - 1], self._samples[number], at_ns)


def _interpolate(before: _Sample, after: _Sample, at_ns: int) -> float:
    """The position between two samples: the cubic with their positions and velocities."""
    duration_s = (after.at_ns - before.at_ns) / NS_PER_S
    share = (at_ns - before.at_ns) / (after.at_ns - before.at_ns)
    share_before = 1 - share
    from_before = (
        share_before * share_before * ((1 + 2 * share) * before.counts + share * duration_s * before.counts_per_s)
    )
    from_after = (
        share * share * ((1 + 2 * share_before) * after.counts - share_before * duration_s * after.counts_per_s)
    )
    return from_before + from_after


class AxisTruth(ABC):
    """The truth about one axis. Times are fleet seconds, as `fleet.now_s`; positions are in the axis's unit.

    They are those of the controller: `set_position` does not shift them.
    """

    def __init__(self, name: str, axis: Axis, origin_ns: int) -> None:
        self._name = name
        self._axis = axis
        self._origin_ns = origin_ns

    def __repr__(self) -> str:
        return f"<truth of {self._name}: {len(self.moves)} moves>"

    @property
    def moves(self) -> list[TrueMove]:
        """All commanded motions so far, in order of start."""
        return [self._make_move(motion) for motion in self._find_motions()]

    def position_at(self, t: float) -> float:
        """The commanded position at fleet time `t`, s, in the axis's unit: exact at begins and ends of moves, between
        them to 1.6 µm for each m/s² by which the acceleration changes at once. Raises `BadTest` for an instant that is
        not known."""
        return self._axis.to_unit(self._find_counts(self._origin_ns + round(t * NS_PER_S)))

    def _make_move(self, motion: CommandedMotion) -> TrueMove:
        end_s = None if motion.end_ns is None else (motion.end_ns - self._origin_ns) / NS_PER_S
        to_position = None if motion.end_counts is None else self._axis.to_unit(motion.end_counts)
        start_s = (motion.start_ns - self._origin_ns) / NS_PER_S
        return TrueMove(start_s, end_s, self._axis.to_unit(motion.start_counts), to_position)

    @abstractmethod
    def _find_motions(self) -> Sequence[CommandedMotion]:
        """All commanded motions so far, in order of start."""

    @abstractmethod
    def _find_counts(self, at_ns: int) -> float:
        """The commanded position at a host instant, in counts of the make. Raises `BadTest`."""

    def _require_past(self, at_ns: int, now_ns: int) -> None:
        if at_ns > now_ns:
            at, now_text = format_s(at_ns - self._origin_ns), format_s(now_ns - self._origin_ns)
            raise BadTest(f"{self._name} at {at}: it is {now_text} now; `fleet.advance` lets time go on")
