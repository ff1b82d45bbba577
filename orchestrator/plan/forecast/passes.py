"""Many passes of the same steps, from three of them.

What a step does to an axis is a move to a position, by a distance, or a shift of user positions. So from the second
pass on, each target differs from that of the pass before by the same distance; passes two and three show which. Targets
then lie on straight lines, and the first pass that leaves a range is found by halving, however many passes there are.
"""

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import NamedTuple

from orchestrator.model.jobs.forecast import AxisForecast

RUN_PASSES = 3  # that are run forward; the others follow from them


class TargetCheck(NamedTuple):
    """A target that was compared with limits. place: of the step and its field. target: motor position of the axis; its
    distance from an unknown beginning unless `known`."""

    place: tuple[str | int, ...]
    axis: str
    target: Fraction
    offset: Fraction
    known: bool


class LaterTarget(NamedTuple):
    """A target in pass 3, and how much it and the user offset differ from pass to pass."""

    check: TargetCheck
    drift: Fraction
    offset_drift: Fraction

    def in_pass(self, number: int) -> TargetCheck:
        """The same target in a later pass, from 3."""
        more = number - RUN_PASSES
        target, offset = self.check.target + more * self.drift, self.check.offset + more * self.offset_drift
        return self.check._replace(target=target, offset=offset)


def find_later_targets(second: Sequence[TargetCheck], third: Sequence[TargetCheck]) -> list[LaterTarget]:
    """The targets of all passes after the third; none if the passes differ in more than positions."""
    if [check[:2] for check in second] != [check[:2] for check in third]:
        return []
    return [
        LaterTarget(check_after, check_after.target - check_before.target, check_after.offset - check_before.offset)
        for check_before, check_after in zip(second, third, strict=True)
        if check_before.known == check_after.known
    ]


def find_first_pass(times: int, leaves: Callable[[int], bool]) -> int | None:
    """The first pass after the third in which `leaves` is true; None if it is in none. Once true it stays true."""
    low, high = RUN_PASSES + 1, times
    if high < low or not leaves(high):
        return None
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if leaves(middle) else (middle + 1, high)
    return low


def find_range(state: AxisForecast, targets: Sequence[LaterTarget], number: int) -> tuple[Fraction, Fraction]:
    """The lowest and highest distance from an unknown beginning up to a pass. state: after the third."""
    reached_targets = [target.in_pass(number).target for target in targets]
    return min([state.lowest, *reached_targets]), max([state.highest, *reached_targets])


def find_last_state(
    before: AxisForecast, after: AxisForecast, targets: Sequence[LaterTarget], times: int
) -> AxisForecast:
    """The state after pass `times`. before, after: after the second and the third; targets: from an unknown beginning
    that all passes have in common."""
    more = times - RUN_PASSES
    if more <= 0 or before.known != after.known or before.since != after.since:
        return after
    update: dict[str, object] = {
        "motor": after.motor + more * (after.motor - before.motor),
        "offset": after.offset + more * (after.offset - before.offset),
    }
    if not after.known:
        lowest, highest = find_range(after, targets, times)
        update |= {"lowest": lowest, "highest": highest}
    return after.model_copy(update=update)


def group_by_axis(targets: Sequence[LaterTarget]) -> Mapping[str, list[LaterTarget]]:
    """The targets of each axis."""
    grouped_targets: dict[str, list[LaterTarget]] = {}
    for target in targets:
        grouped_targets.setdefault(target.check.axis, []).append(target)
    return grouped_targets
