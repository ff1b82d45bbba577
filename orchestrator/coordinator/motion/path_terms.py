"""What the times of members may put the axes of a path beside it, shared out between the members.

The axes of different members are at right angles: delays of all of them at once take the axes off by the root of the
sum of squares of delay times speed, largest over the path. On a circle one axis is slow where the other one is fast, so
that is as little as half of the sum of what each would do alone at its highest speed.
"""

from collections.abc import Mapping

import numpy as np

from orchestrator.model.messages import Proposal
from orchestrator.model.report import PathTerm, PathTermName
from orchestrator.plan.path_profiles import Array
from orchestrator.plan.path_step import PlannedPath


def make_time_terms(
    path: PlannedPath,
    proposals: Mapping[str, Proposal],
    halves_s: Mapping[str, float],
    within_s: Mapping[str, float],
) -> list[PathTerm]:
    """The terms `start` and `clock`. halves_s: by member, how far its start may be from the middle of all. within_s: by
    member, the longest time that it relies on a fit of its clock; others rely on that of the start."""
    starts: dict[str, Array] = {}
    clocks: dict[str, Array] = {}
    for member, half_s in halves_s.items():
        times_s, member_speeds = path.find_speeds(member)
        # It is that fast a little earlier or later as well.
        speeds = np.maximum(member_speeds, np.interp(times_s - half_s, times_s, member_speeds))
        speeds = np.maximum(speeds, np.interp(times_s + half_s, times_s, member_speeds))
        starts[member] = half_s * speeds
        ages_s = np.minimum(times_s, within_s.get(member, np.inf))
        clocks[member] = proposals[member].clock_ppm * 1e-6 * ages_s * speeds
    return [*_share_out("start", starts), *_share_out("clock", clocks)]


def _share_out(name: PathTermName, errors: Mapping[str, Array]) -> list[PathTerm]:
    """A term for each member, together the largest error of all; in proportion to the squares of their own largest."""
    largest_error = float(np.sqrt(np.sum([error**2 for error in errors.values()], axis=0)).max())
    parts = {member: float(error.max()) ** 2 for member, error in errors.items()}
    total = sum(parts.values())
    return [
        PathTerm(name=name, member=member, size=largest_error * part / total if total else 0.0)
        for member, part in parts.items()
    ]
