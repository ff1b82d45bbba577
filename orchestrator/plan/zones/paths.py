"""What the axes of a path may do besides their plan."""

import math
from collections.abc import Mapping

from orchestrator.plan.path_clock import MOST_RATE
from orchestrator.plan.path_step import PlannedPath
from orchestrator.plan.zones.course import PathTerms

LOADED_CHUNKS = 2
"""That a controller has at most: the present one, and the next one."""


def find_path_terms(path: PlannedPath) -> dict[str, PathTerms]:
    """By axis; of a line on a trapezoid, which is a move, none."""
    if path.course is None:
        return {}
    sizes = path.counts_per_unit
    return {name: PathTerms(MOST_RATE, path.course.fit_error * abs(sizes[name])) for name in path.plan.profiles}


def bound_alone(alone: Mapping[str, float | None], chunks: Mapping[str, float]) -> dict[str, float | None]:
    """For how long controllers go on along a path without their adapters, s: no longer than what they have of it.
    chunks: the longest chunk that controllers take, s, of those that load paths in chunks."""
    bounds = dict(alone)
    for name, chunk_s in chunks.items():
        if name not in alone:
            continue  # it has not answered, and counts as one that has
        alone_s = alone[name]
        bounds[name] = min(math.inf if alone_s is None else alone_s, LOADED_CHUNKS * chunk_s)
    return bounds
