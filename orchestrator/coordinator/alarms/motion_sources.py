"""Alarms of motion: budgets that are nearly used up, and following errors that grow. They look at what has been."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from orchestrator.coordinator.alarms.conditions import AlarmConditions
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.alarm_rules import FollowingRule
from orchestrator.model.fleet import Axis
from orchestrator.model.operation.alarms import MAX_SUBJECT, AlarmCause
from orchestrator.model.report import StepRecording, StepReport
from orchestrator.model.state import ControllerState

NOISE_COUNTS = 2  # a smaller following error is rounding
MAX_SETS = 200  # of controllers that move together, whose budgets are watched


@dataclass(slots=True)
class FollowingTrend:
    """The following errors of one axis, move by move: how long it lags behind, s, and how far, in its unit.

    The lag is compared, because a servo's following error grows with its speed.
    """

    moves: int
    lags_s: deque[float] = field(default_factory=deque[float])
    errors: deque[float] = field(default_factory=deque[float])
    earlier_s: float = 0.0
    earlier: int = 0

    def add_move(self, lag_s: float, error: float) -> None:
        """Add the means of a move."""
        self.lags_s.append(lag_s)
        self.errors.append(error)
        while len(self.lags_s) > self.moves:
            self.earlier_s += self.lags_s.popleft()
            self.earlier += 1
            self.errors.popleft()

    def explain_growth(self, rule: FollowingRule, allowed: float | None, noise: float) -> str | None:
        """What has grown too much, in words. allowed: the largest permitted error; noise: the least one that counts."""
        if len(self.errors) < self.moves:
            return None
        error, lag_s = sum(self.errors) / self.moves, sum(self.lags_s) / self.moves
        if error < noise:
            return None
        if allowed is not None and error > rule.limit * allowed:
            return f"is {error:.4g} in the mean of {self.moves} moves, {error / allowed:.0%} of what is permitted"
        usual_s = self.earlier_s / self.earlier if self.earlier >= self.moves else 0.0
        if usual_s and lag_s > rule.growth * usual_s:
            return f"has grown to {lag_s / usual_s:.1f} times its earlier mean, at the same speed"
        return None


@dataclass(slots=True)
class _MoveSums:
    """Sums over the readings of one axis in a move."""

    readings: int = 0
    error: float = 0.0
    speed: float = 0.0


class MotionAlarms:
    """Reports the conditions of moves."""

    def __init__(self, view: FleetView, conditions: AlarmConditions) -> None:
        self._view = view
        self._conditions = conditions
        self._near: dict[str, int] = {}
        """By controllers that move together: how many steps in succession have nearly used their budget."""
        self._sums: dict[str, _MoveSums] = {}
        self._trends: dict[str, FollowingTrend] = {}

    def take_state(self, state: ControllerState) -> None:
        """Sum up the following errors of a moving controller; a listener of the view."""
        if state.mode != "moving":
            return
        config = self._view.fleet.controllers[state.controller]
        for name, axis_now in state.axes.items():
            if axis_now.moving and name in config.axes:
                axis = f"{state.controller}.{name}"
                sums = self._sums.get(axis)
                if sums is None:
                    sums = self._sums[axis] = _MoveSums()
                sums.readings += 1
                sums.error += abs(config.axes[name].to_length(axis_now.commanded_counts - axis_now.raw_counts))
                sums.speed += abs(axis_now.velocity)

    def take_motion(self, recording: StepRecording, report: StepReport | None) -> None:
        """A motion step is over. report: None for one that was interrupted."""
        for axis in recording.axes:
            sums = self._sums.pop(axis, None)
            if sums is not None and sums.speed and self._view.fleet.has_axis(axis):
                self._note_following(axis, self._view.fleet.axis(axis), sums)
        if report is not None and report.state == "done":
            self._note_budget(report)

    def _note_following(self, axis: str, config: Axis, sums: _MoveSums) -> None:
        rule = self._view.fleet.alarms.following_error
        trend = self._trends.get(axis)
        if trend is None or trend.moves != rule.moves:
            trend = self._trends[axis] = FollowingTrend(rule.moves)
        trend.add_move(sums.error / sums.speed, sums.error / sums.readings)
        noise = NOISE_COUNTS / float(abs(config.counts_per_unit))
        growth = trend.explain_growth(rule, config.following_error, noise)
        text = f"the following error of {axis} {growth}"
        action = "look for friction, load and loose parts; compare `tutti job plot` with an earlier one"
        self._conditions.report(AlarmCause("following-error", axis, text, action), holds=growth is not None)

    def _note_budget(self, report: StepReport) -> None:
        skew, budget, rule = report.narrowest_skew, report.budget, self._view.fleet.alarms.budget
        if skew is None or budget is None or len(report.members) < 2 or not budget.allowed_ns:
            return
        members = name_members(list(report.members))
        used = skew.at_most_ns / budget.allowed_ns
        near_count = self._near.pop(members, 0) + 1 if used > rule.limit else 0
        if near_count:
            self._near[members] = near_count
            while len(self._near) > MAX_SETS:
                del self._near[next(iter(self._near))]
        text = f"{near_count} steps in succession of {members} have used more than {rule.limit:.0%} of their start skew"
        action = (
            f"see `tutti job report last`: {budget.worst_member}, {budget.worst_term}; allow more, or mend its link"
        )
        self._conditions.report(AlarmCause("budget", members, text, action), holds=near_count >= rule.steps)


def name_members(members: Sequence[str]) -> str:
    """Controllers that move together, as the subject of an alarm."""
    names = "+".join(sorted(members))
    return names if len(names) <= MAX_SUBJECT else names[:MAX_SUBJECT].rpartition("+")[0]
