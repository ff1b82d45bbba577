"""How far the axes of a path step may be off it: a bound ahead, term by term and member by member.

A common delay of all members changes nothing on the path: only what sets them apart counts. So the terms `start` and
`clock` exist only where there are at least two members; they are taken around the middle of all start windows.
"""

from collections.abc import Mapping, Sequence
from math import hypot

import numpy as np

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.motion.budget import StartWindow
from orchestrator.coordinator.motion.path_terms import make_time_terms
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import ChunkReply, Proposal
from orchestrator.model.report import PathBound, PathTerm, PathTermName, SyncBudget
from orchestrator.plan.path_step import PlannedPath

_REMEDIES: dict[PathTermName, str] = {
    "profile-fit": "allow a larger `tolerance`",
    "compensation": "choose a path without reversals of an axis with play, a table with less uncertainty, or ",
    "execution": "move slower (`speed`), which the controller then interpolates more finely, or ",
    "start": "move slower (`speed`), give the clocks time to settle, or use a trigger line (`start_class: line`), or ",
    "clock": "move slower or shorter, give the clocks time to settle, or ",
}


def make_path_bound(
    path: PlannedPath,
    proposals: Mapping[str, Proposal],
    windows: Mapping[str, StartWindow],
    within_s: Mapping[str, float],
) -> PathBound:
    """The bound of a path whose members have answered. windows: of their starts. within_s: by member, the longest time
    from a fit of its clock to the end of the chunk that relies on it; others rely on that of the start."""
    terms = [PathTerm(name="profile-fit", size=path.fit_error)]
    if path.compensation_error:
        terms.append(PathTerm(name="compensation", size=path.compensation_error))
    for member in windows:
        errors = [
            counts / abs(path.counts_per_unit[f"{member}.{axis}"])
            for axis, counts in proposals[member].path_error_counts.items()
            if f"{member}.{axis}" in path.counts_per_unit
        ]
        terms.append(PathTerm(name="execution", member=member, size=hypot(*errors)))
    if len(windows) > 1:
        terms += make_time_terms(path, proposals, _find_half_windows(windows), within_s)
    return PathBound(
        unit=path.report.unit,
        tolerance=path.tolerance,
        predicted=float(np.sum([term.size for term in terms])),
        terms=terms,
    )


def require_tolerance(bound: PathBound, members: Sequence[str]) -> None:
    """Raise `Refusal` for a bound above the tolerance: the largest term, its member, and what would fit."""
    if bound.predicted <= bound.tolerance:
        return
    worst, unit = bound.largest, bound.unit
    by = f"{worst.member}, by its {worst.name}" if worst.member else f"the {worst.name}"
    more = "" if worst.name == "profile-fit" else f"allow `tolerance: {_round_up(bound.predicted)} {unit}`"
    raise Refusal(
        "path-error",
        f"the axes may be {bound.predicted:.3g} {unit} off the path; the tolerance is {bound.tolerance:.3g} {unit}. "
        f"Largest is {by}: {worst.size:.3g} {unit}",
        _REMEDIES[worst.name] + more,
        worst.member or members[0],
    )


class ClockPromises:
    """By how much the clocks of members may be off, as they have promised at the start. bound: of the path."""

    def __init__(self, bound: PathBound | None, budget: SyncBudget | None) -> None:
        self._bound = bound
        self._promised_ns = {
            name: max((term.latest_ns for term in member.terms if term.name == "clock"), default=0)
            for name, member in (budget.members if budget is not None else {}).items()
        }

    def require_within(self, member: str, reply: ChunkReply, speed: float) -> None:
        """Raise `Refusal` for a member whose clock is known less well than at the start, if that is too much for the
        tolerance. speed: of its axes together at most, in the unit of the path per s."""
        bound = self._bound
        beyond_ns = abs(reply.left_ns) + max(0, reply.bound_ns - self._promised_ns.get(member, reply.bound_ns))
        if bound is None or len(self._promised_ns) < 2 or not beyond_ns:
            return
        excess = beyond_ns / NS_PER_S * speed
        if bound.predicted + excess > bound.tolerance:
            text = f"its clock is off by {beyond_ns / NS_PER_MS:.2f} ms more than promised: {excess:.3g} {bound.unit}"
            raise Refusal("path-error", text, "give the clocks time to settle, or allow a larger `tolerance`", member)


def require_bound(bound: PathBound, rate: float) -> None:
    """Raise `Refusal` for a rate of the planned speed at which the axes may be farther off the path than allowed."""
    if rate > 1.0 and bound.predicted * rate > bound.tolerance:
        text = f"at {rate:.0%} the axes may be {bound.predicted * rate:.3g} {bound.unit} off the path"
        raise Refusal("path-error", text, f"the tolerance is {bound.tolerance:.3g}; choose a lower speed")


def _round_up(value: float) -> str:
    """A tolerance that fits, with two digits and some room for the next proposals."""
    return f"{float(f'{value * 1.1:.1e}'):g}"


def _find_half_windows(windows: Mapping[str, StartWindow]) -> dict[str, float]:
    """By member, how far its start may be from the middle of all windows, s. The instant of the edge of a trigger line
    that all of them wait for is common to them."""
    edges = {window.edge for window in windows.values()}
    common = next(iter(edges)) if len(edges) == 1 else None
    early_ns, late_ns = common or (0, 0)
    spans = {name: (window.earliest_ns - early_ns, window.latest_ns - late_ns) for name, window in windows.items()}
    middle_ns = (min(early for early, _ in spans.values()) + max(late for _, late in spans.values())) / 2
    return {name: max(middle_ns - early, late - middle_ns) / NS_PER_S for name, (early, late) in spans.items()}
