"""A pause on a path at a place ahead, such as between two lines of a scan: where the path is braked for it."""

from dataclasses import dataclass

import numpy as np

from orchestrator.model.errors import Refusal
from orchestrator.plan.path_clock import PathClock
from orchestrator.plan.path_course import SWITCH_S, ChunkPlan, PathCourse


@dataclass(frozen=True, slots=True)
class FeedPause:
    """A pause that was asked for. path_s: place of it on the path, s of its time."""

    actor: str
    path_s: float

    def is_before(self, chunk: ChunkPlan) -> bool:
        """Whether it comes before the end of a chunk."""
        return float(chunk.clock.find_instants(np.array([self.path_s]))[0]) < chunk.end_s

    def brake_in_chunk(self, course: PathCourse, clock: PathClock, begin_s: float, most_s: float) -> PathClock:
        """The clock of the chunk from `begin_s` on, at most `most_s` long, braked behind the place if it reaches
        it."""
        place_s = max(clock.find_instant(self.path_s), begin_s + SWITCH_S)
        if clock.rate <= 0.0 or place_s >= begin_s + most_s:
            return clock
        try:
            slow_clock = course.brake(clock, place_s)
        except Refusal:
            return clock
        return slow_clock if slow_clock.ramps[-1].end_s <= begin_s + most_s else clock
