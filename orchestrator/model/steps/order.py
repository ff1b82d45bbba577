"""The steps of a job in the order in which they run, by arithmetic: repeats and scans are never written out.

Every pass of a repeat and every point of a scan has step numbers of its own, from 0: a point is one move, then the
steps at it. These are the numbers in fields: on the bus, and of reports and re-runs. People count steps, points and
passes from 1: `number_step`.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

from orchestrator.model.steps.base import Step
from orchestrator.model.steps.live import Live
from orchestrator.model.steps.numbers import name_step
from orchestrator.model.steps.repeat import Repeat
from orchestrator.model.steps.scan import Scan


class RemainingStep(NamedTuple):
    """What is left of a written step. first: the number of the first step left of it; number: in the job file."""

    first: int
    number: int
    step: Step


@dataclass(frozen=True, slots=True)
class StepPlace:
    """Where a numbered step stands.

    index: its number. step: as it is written; for a point, the whole scan; for what a live job was asked for, its live
    step. first: the number of the first step of the scan, or of the step itself. point: of a scan or a live step, from
    0; of a line that is flown its first one. part: 0 is the move to the point, k the k-th step at it; of a line that
    is flown the last one is its path. passes: pass and number of passes of each repeat around
    it, from 1, the outermost first. asked, asked_count: of a live job, the step that was asked for, None while it waits
    for one; and for how many it was asked so far.
    """

    index: int
    step: Step
    first: int
    point: int | None = None
    part: int = 0
    passes: tuple[tuple[int, int], ...] = ()
    asked: Step | None = None
    asked_count: int = 0

    @property
    def series(self) -> Scan | Live | None:
        """The step that has one report for all that runs in it, to which this one belongs."""
        return self.step if isinstance(self.step, Scan | Live) else None

    @property
    def point_count(self) -> int | None:
        """The number of points of its scan, or of the steps that its live job was asked for."""
        return self.asked_count if self.step.is_open else None if self.scan is None else self.scan.point_count

    @property
    def scan(self) -> Scan | None:
        """The scan that it belongs to."""
        return self.step if isinstance(self.step, Scan) else None

    @property
    def kind(self) -> str:
        """What the numbered step does: that of its own, of a point its move or the step at it."""
        if self.scan is None:
            return self.step.kind if self.asked is None else self.asked.kind
        if self.scan.fly is not None:
            return "path" if self.is_flown_path else "wait" if self.part else "move"
        return self.scan.at_each[self.part - 1].kind if self.part else "move"

    @property
    def is_flown_path(self) -> bool:
        """Whether it is the way through the windows of a line that is flown."""
        return self.scan is not None and self.scan.fly is not None and self.part == self.scan.points_steps - 1

    @property
    def terms_index(self) -> int | None:
        """The number of the step that says on which terms this one waits armed: the one before it, or before its scan
        for the flight of the first line. None: no step does."""
        if self.scan is None or self.point is None:
            return self.index - 1 if self.index else None
        is_first_flight = self.is_flown_path and self.index < self.first + self.scan.points_steps
        return self.first - 1 if is_first_flight and self.first else None

    @property
    def is_path(self) -> bool:
        """Whether axes follow a path in it."""
        return self.is_flown_path or (self.scan is None and self.step.follows_path)

    @property
    def step_name(self) -> str:
        """What progress calls it: its name, or what it does; of a live job, `live` and that."""
        if self.asked is not None:
            return f"live: {self.asked.name or self.asked.kind}"
        return self.step.name or self.step.kind

    @property
    def is_later_point(self) -> bool:
        """Whether it belongs to a scan or a live step, and is not its first step."""
        return self.point is not None and self.index > self.first

    def describe(self, *, kinds: bool = True) -> str:
        """The place in words: `step 3 (scan), point 17 of 66 (move)`. kinds: with what is done there."""
        words = name_step(self.first) + f" ({self.step.kind})" * kinds
        if self.scan is not None and self.point is not None:
            words += f", {self._describe_points(self.scan)}" + f" ({self.kind})" * kinds
        elif self.asked is not None and self.point is not None:
            words += f", move {self.point + 1}" + f" ({self.kind})" * kinds
        return words + "".join(f", pass {number} of {times}" for number, times in self.passes)

    def _describe_points(self, scan: Scan) -> str:
        assert self.point is not None
        if scan.fly is None:
            return f"point {self.point + 1} of {scan.point_count}"
        last = self.point + scan.line_points
        return f"points {self.point + 1} to {last} of {scan.point_count}"

    def choose_step(self, find_motion: Callable[[Scan], Step]) -> Step:
        """The step that runs: of a scan, the move to its point, or the step there. find_motion: returns that move, and
        of a scan that flies the path as well."""
        if self.scan is None:
            return self.asked or self.step
        if self.scan.fly is not None and self.scan.fly.wait is not None and self.kind == "wait":
            return self.scan.fly.wait
        if self.scan.fly is not None or not self.part:
            return find_motion(self.scan)
        return self.scan.at_each[self.part - 1]


def count_reports(steps: Iterable[Step]) -> int:
    """The number of entries in the report of steps."""
    return sum(step.report_count for step in steps)


class StepOrder:
    """The order of `steps`, run `repeat` times. Memory: that of the written steps."""

    def __init__(self, steps: Sequence[Step], repeat: int = 1) -> None:
        self._block = _Block(steps)
        self._repeat = repeat

    def __len__(self) -> int:
        return self._block.size * self._repeat

    def locate(self, index: int) -> StepPlace:
        """Where step number `index` stands. Raises `IndexError`."""
        if not 0 <= index < len(self):
            raise IndexError(f"no step {index}; counted from 0, the steps are 0 to {len(self) - 1}")
        block, offset, passes = self._block, index % self._block.size, tuple[tuple[int, int], ...]()
        while True:
            number, offset = block.find(offset)
            step = block.steps[number]
            if isinstance(step, Repeat):
                block = block.inner[number]
                pass_count, offset = divmod(offset, block.size)
                passes = (*passes, (pass_count + 1, step.times))
            elif isinstance(step, Scan):
                number, part = divmod(offset, step.points_steps)
                point = number * step.points_together
                return StepPlace(index=index, step=step, first=index - offset, point=point, part=part, passes=passes)
            else:
                return StepPlace(index, step, index, passes=passes)

    def list_remaining(self, first: int = 0) -> list[RemainingStep]:
        """What is left from step number `first` on: a scan is whole, a repeat has the passes that are left, after the
        rest of the present one. None beyond the last step."""
        passes, offset = divmod(first, self._block.size)
        remaining_steps = [] if passes >= self._repeat else list(self._block.list_rest(offset))
        remaining_steps += list(self._block.list_rest(0)) * (self._repeat - passes - 1)
        indices = accumulate((size for _, _, size in remaining_steps), initial=first)
        return [
            RemainingStep(index, number, step)
            for index, (number, step, _) in zip(indices, remaining_steps, strict=False)
        ]

    def iterate_written(self) -> Iterator[tuple[int, Step]]:
        """The written steps of the job, each with the number of its first step in the first run."""
        return iter(zip(self._block.begins, self._block.steps, strict=True))


class _Block:
    """Steps that run one after the other. begins: by step, how many come before it; size: of all."""

    def __init__(self, steps: Sequence[Step]) -> None:
        self.steps = steps
        ends = list(accumulate(step.step_count for step in steps))
        self.size = ends[-1]
        self.begins = [0, *ends[:-1]]
        self.inner = {number: _Block(step.steps) for number, step in enumerate(steps) if isinstance(step, Repeat)}

    def find(self, within: int) -> tuple[int, int]:
        """The written step that step `within` of this block belongs to, and how far inside that one it is."""
        number = bisect_right(self.begins, within) - 1
        return number, within - self.begins[number]

    def list_rest(self, within: int) -> Iterator[tuple[int, Step, int]]:
        """What is left from step `within` on: the number of the written step in this block, what is left of it, and of
        how many steps that is."""
        number, offset = self.find(within)
        step = self.steps[number]
        if offset and isinstance(step, Repeat):
            block = self.inner[number]
            passes, offset = divmod(offset, block.size)
            if offset:
                yield from ((number, leaf, size) for _, leaf, size in block.list_rest(offset))
            times_left = step.times - passes - bool(offset)
            if times_left:
                yield number, step.model_copy(update={"times": times_left}), times_left * block.size
        else:
            yield number, step, step.step_count - offset
        for later_number, later_step in list(enumerate(self.steps))[number + 1 :]:
            yield later_number, later_step, later_step.step_count
