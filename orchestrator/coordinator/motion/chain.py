"""Steps back to back: a step is planned, negotiated and loaded while the one before it moves.

Each step keeps its own promise, decision and verdict. If a member is not ready in time, the fleet rests at the end of
the step before, and the step starts from there with a new T0.
"""

from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_MS

RELEASE_SLACK_NS = 15 * NS_PER_MS  # more than the known time for promise, decision and release
END_SEEN_NS = 8 * NS_PER_MS  # from the end of a move until its adapter has noticed it


@dataclass(frozen=True, slots=True)
class PresentMove:
    """The moving step that another one follows.

    step: its number. ends_fleet_ns: by then all its members have ended. pause_ns: dwell between the two steps. acts:
    outputs are switched between the two, before the second one is decided.
    """

    step: int
    ends_fleet_ns: int
    pause_ns: int = 0
    acts: bool = False
