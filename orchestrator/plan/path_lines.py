"""When each line of the file runs that a path was made of."""

from typing import NamedTuple

import numpy as np

from orchestrator.model.steps.path import FollowPath
from orchestrator.plan.path.arc_length import Array, Index
from orchestrator.plan.path.plan import PathPlan


class LineTimes(NamedTuple):
    """The lines of a path in the order in which they run, and when each ends, in the time of the path."""

    lines: Index
    ends_s: Array

    def find_line(self, path_s: float) -> int:
        """The line that runs at an instant of the path; before it the first one, after it the last one."""
        number = int(np.searchsorted(self.ends_s, path_s, side="right"))
        return int(self.lines[min(number, len(self.lines) - 1)])


def time_lines(step: FollowPath, plan: PathPlan) -> LineTimes | None:
    """The lines of a planned path; None: it was made of no file, or of one whose lines are not known."""
    lines = [] if step.source is None else step.source.list_lines()
    if len(lines) != len(step.pieces):
        return None
    pieces, ends_s = plan.find_piece_ends()
    piece_lines = np.array(lines, dtype=np.int64)[pieces]
    last = np.append(np.diff(piece_lines) != 0, True)  # of the pieces of one line
    return LineTimes(piece_lines[last], ends_s[last])
