"""How far virtual axes may be off their straight line on the way, because their real axes are not together in time.

With e the offset in time of a real axis and v its highest speed, it is at most v x e from where the plan has it. An
offset that all have in common only shifts the whole along the line. So each virtual axis is off by at most the sum over
its real axes of |m| x (v x |e - c| + path error + rounding), with m its factor, and c the middle of all offsets. The
tables of corrected axes add their uncertainty, and what they bend between the ends of the way; where their real axes
move in their own time, these are off by what the tables differ on it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.compensation import Approach
from orchestrator.model.fleet import Fleet
from orchestrator.model.linear_map import CorrectedMap, LinearMap
from orchestrator.model.messages import Proposal
from orchestrator.model.names import split_name
from orchestrator.model.report import PathReport, SyncBudget, VirtualBound
from orchestrator.model.steps.kinds import Motion
from orchestrator.plan.corrected import TableWay, bound_apart, bound_straight
from orchestrator.plan.play import bound_way
from orchestrator.plan.step import StepPlan
from orchestrator.plan.virtual_moves import group_virtual

ROUNDED_COUNTS = 1.0  # of a target to counts, and of a controller's profile on the way


@dataclass(frozen=True, slots=True)
class CurvedLine:
    """How a path of real axes keeps a curved group on its line. errors: by virtual axis, of the path as it is planned,
    in its unit. factors: how far it moves by one count of the real axes together, at most on the way."""

    errors: Mapping[str, float]
    factors: Mapping[str, float]

    def bound(self, fleet: Fleet, counts: float) -> dict[str, VirtualBound]:
        """How far each virtual axis may be off its line, where the real axes may be off their path by `counts`."""
        return {
            name: VirtualBound(most=self.errors[name] + factor * counts, unit=fleet.unit_of(name))
            for name, factor in self.factors.items()
        }


class AgreedStart(Protocol):
    """What the members of a step have agreed on."""

    @property
    def plan(self) -> StepPlan: ...

    @property
    def proposals(self) -> Mapping[str, Proposal]: ...

    @property
    def budget(self) -> SyncBudget | None: ...

    @property
    def path(self) -> PathReport | None: ...


def bound_virtual_axes(
    fleet: Fleet, step: Motion, agreement: AgreedStart, line: CurvedLine | None
) -> dict[str, VirtualBound]:
    """The bound of each virtual axis of the groups that a step moves, in its unit; none without a budget. line: of a
    curved group."""
    if line is not None and agreement.path is not None and agreement.path.bound is not None:
        return line.bound(fleet, agreement.path.bound.predicted)
    if agreement.budget is None:
        return {}
    bounds: dict[str, VirtualBound] = {}
    for group in group_virtual(fleet, step):
        virtual_map = fleet.virtual_axes.maps[group]
        if not isinstance(virtual_map, LinearMap):
            continue  # of one real axis, which is on its curve wherever it is
        factors, own_errors = virtual_map.rows, [0.0] * len(virtual_map.virtual)
        if isinstance(virtual_map, CorrectedMap):
            way = TableWay.of_profiles(fleet, virtual_map, agreement.plan.profiles)
            if not step.is_synchronised:
                sizes = bound_apart(fleet, virtual_map, way, step.asked_approach)
                bounds |= _make_bounds(fleet, virtual_map.virtual, sizes)
                continue
            factors, own_errors = virtual_map.factors, bound_straight(virtual_map, way)
        errors = _bound_real_axes(fleet, virtual_map, agreement, step.asked_approach)
        sizes = [
            own + sum(abs(factor) * errors[axis] for factor, axis in zip(row, virtual_map.real, strict=True))
            for row, own in zip(factors, own_errors, strict=True)
        ]
        bounds |= _make_bounds(fleet, virtual_map.virtual, sizes)
    return bounds


def _make_bounds(fleet: Fleet, names: Sequence[str], sizes: Sequence[float]) -> dict[str, VirtualBound]:
    return {name: VirtualBound(most=size, unit=fleet.unit_of(name)) for name, size in zip(names, sizes, strict=True)}


def _bound_real_axes(
    fleet: Fleet, virtual_map: LinearMap, agreement: AgreedStart, approach: Approach | None
) -> dict[str, float]:
    """How far each real axis may be from where a common offset in time would have it, in its unit. approach: of the
    step."""
    offsets = {axis: _find_offsets(axis, agreement) for axis in virtual_map.real if axis in agreement.plan.profiles}
    ends = [end for span in offsets.values() for end in span]
    middle_ns = (min(ends) + max(ends)) / 2 if ends else 0.0
    errors: dict[str, float] = {}
    for axis in virtual_map.real:
        counts = ROUNDED_COUNTS
        if axis in offsets:
            controller, name = split_name(axis)
            most_ns = max(abs(end - middle_ns) for end in offsets[axis])
            counts += agreement.plan.profiles[axis].peak_velocity * most_ns / NS_PER_S
            counts += agreement.proposals[controller].path_error_counts.get(name, 0.0)
        errors[axis] = abs(fleet.axis(axis).to_length(counts)) + bound_way(fleet.axis(axis), approach)
    return errors


def _find_offsets(axis: str, agreement: AgreedStart) -> tuple[float, float]:
    """The offsets in time of an axis on its way, ns: of its start, and what its controller's clock adds until the
    end."""
    assert agreement.budget is not None
    controller, name = split_name(axis)
    member, proposal = agreement.budget.members[controller], agreement.proposals[controller]
    took_s = proposal.durations_s.get(name, agreement.plan.duration_s)
    # A profile that the controller makes longer is late by that at its end.
    longer_ns = (took_s - agreement.plan.duration_s) * NS_PER_S
    crystal_ns = took_s * proposal.clock_ppm * 1e3
    return (
        member.earliest_ns + min(longer_ns, 0.0) - crystal_ns,
        member.latest_ns + max(longer_ns, 0.0) + crystal_ns,
    )
