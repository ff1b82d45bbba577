"""The ways of axes in a motion that is run forward, in counts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

from orchestrator.model.compensation import Approach
from orchestrator.model.steps.path import FollowPath
from orchestrator.plan.path_step import PlannedPath
from orchestrator.plan.step import AxisMove, StepPlan
from orchestrator.plan.triggers import ResolvedTrigger


@dataclass(frozen=True, slots=True)
class ForecastMotion:
    """A motion step in counts, planned from where the steps before it leave its axes. line, line_words: the path
    that it is, if it is the first line of a scan that flies, and how all of them are flown."""

    moves: list[AxisMove]
    exact: Mapping[str, tuple[Fraction, int]]
    plan: StepPlan
    path: PlannedPath | None = None
    triggers: Sequence[ResolvedTrigger] = ()
    line: FollowPath | None = None
    line_words: str = ""


@dataclass(slots=True)
class MoveWays:
    """The ways of the axes of a motion, in counts. farthest: bounds of them, where the beginning is not known; bounded:
    whether there is a bound. approach: what the step states."""

    approach: Approach | None = None
    nearest: list[AxisMove] = field(default_factory=list[AxisMove])
    farthest: list[AxisMove] = field(default_factory=list[AxisMove])
    exact: dict[str, tuple[Fraction, int]] = field(default_factory=dict[str, tuple[Fraction, int]])
    bounded: bool = True
    plan: StepPlan | None = None

    def add_known(self, move: AxisMove) -> None:
        self.nearest.append(move)
        self.farthest.append(move)

    def add_unknown(self, longest: AxisMove | None) -> None:
        if longest is None:
            self.bounded = False
        else:
            self.farthest.append(longest)
