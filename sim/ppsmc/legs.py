"""Parts of an activity: motions and pauses, and the reasons for the end of a motion."""

from collections.abc import Generator
from dataclasses import dataclass
from enum import Enum, auto

from sim.ppsmc.path import SpeedProfile, StepPath
from sim.ppsmc.sensors import UntilSwitch


class MotionEnd(Enum):
    """Reason for the end of a motion."""

    DONE = auto()
    STOPPED = auto()
    """By q, with its ramp."""
    LIMIT = auto()
    """By a limit switch, dead (L2546)."""
    SWITCH = auto()
    """At the requested switch: its `UntilSwitch`."""


class TaskKind(Enum):
    """Kinds of task."""

    POSITIONING = auto()
    JOG = auto()
    SPIN = auto()
    OSCILLATION = auto()
    HOMING = auto()


@dataclass(frozen=True, slots=True)
class MotionLeg:
    """One motion. With `seeks_limit` a limit switch ends it without an error."""

    path: StepPath
    profile: SpeedProfile
    until: UntilSwitch | None = None
    seeks_limit: bool = False
    soft: bool = False
    """At its `UntilSwitch` it decelerates instead of stopping dead."""
    at_ns: int | None = None
    """Device time of the start; None: now."""


@dataclass(frozen=True, slots=True)
class PauseStep:
    """Standstill, device ns."""

    duration_ns: int


Steps = Generator[MotionLeg | PauseStep, MotionEnd, None]
