"""Steps back to back: a step is planned, negotiated and loaded while the one before it moves.

Each step keeps its own promise, decision and verdict. If a member is not ready in time, the fleet rests at the end of
the step before, and the step starts from there with a new T0.
"""

from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_MS

# More than the known time for promise, decision and release: a factor on it, and a time.
RELEASE_SLACK = 1.5
RELEASE_SLACK_NS = 15 * NS_PER_MS
END_SEEN_NS = 8 * NS_PER_MS  # from the end of a move until its adapter has noticed it


@dataclass(frozen=True, slots=True)
class BetweenSteps:
    """What happens between two motion steps. pause_ns: dwell. acts: outputs are switched, before the second step is
    decided."""

    pause_ns: int = 0
    acts: bool = False


@dataclass(frozen=True, slots=True)
class PresentMove:
    """The moving step that another one follows.

    step: its number. ends_fleet_ns: by then all its members have ended. planned_end_ns: the same for members that start
    at T0 exactly; those that hold the next step know their own start and end by their own clock."""

    step: int
    ends_fleet_ns: int
    planned_end_ns: int
    between: BetweenSteps = BetweenSteps()
