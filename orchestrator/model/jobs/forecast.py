"""What a job will do, as far as it can be known before it runs."""

from fractions import Fraction
from typing import Any, Literal

from pydantic import Field

from orchestrator.model.base import Model, Rational
from orchestrator.model.compensation import Play
from orchestrator.model.report import PairBound, PathReport, PositionBound, RackBound, VirtualBound


class AxisForecast(Model):
    """Where an axis will be before a step, in its unit. All coordinates are motor positions.

    known: `motor` is its position; otherwise it is the distance from where it was at step `since`. lowest, highest:
    extremes of that distance so far. offset: user minus motor position; `start`: the same from the unknown position on;
    `unknown`: it cannot be known. enabled, referenced: None if only the controller knows.
    """

    motor: Rational = Fraction(0)
    known: bool = False
    since: int = 0
    lowest: Rational = Fraction(0)
    highest: Rational = Fraction(0)
    offset: Rational = Fraction(0)
    offset_kind: Literal["motor", "start", "unknown"] = "motor"
    enabled: bool | None = None
    referenced: bool | None = None
    play: Play | None = Field(default=None, exclude_if=lambda play: play is None)


class StepForecast(Model):
    """One step. least_s, most_s: its duration; most_s None: no bound is known. conditions: what only the world decides.
    virtual: how far virtual axes may be off their line; only in a dry run. bounds: how far axes with `backlash` or
    `correction`, or of corrected groups, may be from their targets. followers: real axes that move along by errors of
    others, by name with their group. racks: how far the motors of axes of two may be apart; pairs: how far pairs
    may be racked after any single fault.
    lines: of a scan that flies, how fast, and how long a line takes; path: of its first line.

    commands: by controller, what it would be sent; only in a dry run. refused: why a controller would refuse it.
    """

    index: int
    do: str
    text: str
    least_s: float = 0.0
    most_s: float | None = 0.0
    conditions: list[str] = Field(default=[])
    budget: dict[str, Any] | None = None
    path: PathReport | None = None
    virtual: dict[str, VirtualBound] = Field(default={})
    bounds: dict[str, PositionBound] = Field(default={})
    followers: dict[str, str] = Field(default={}, exclude_if=lambda followers: not followers)
    racks: dict[str, RackBound] = Field(default={}, exclude_if=lambda racks: not racks)
    pairs: dict[str, PairBound] = Field(default={})
    lines: str = ""
    commands: dict[str, list[str]] = Field(default={})


class StepProblem(Model):
    """A mistake in a step of a job. place: keys and indices in the job file."""

    place: list[str | int]
    code: str
    text: str
    remedy: str = ""
    controller: str | None = None

    def describe(self) -> str:
        """Text and remedy."""
        return f"{self.text}; {self.remedy}" if self.remedy else self.text


class JobForecast(Model):
    """All steps of a job. conditions: of the job as a whole, in words."""

    steps: list[StepForecast] = Field(default=[])
    problems: list[StepProblem] = Field(default=[])
    conditions: list[str] = Field(default=[])

    @property
    def least_s(self) -> float:
        """The shortest total duration, s."""
        return sum(step.least_s for step in self.steps)

    @property
    def most_s(self) -> float | None:
        """The longest total duration, s; None if no bound is known."""
        longest = [step.most_s for step in self.steps]
        return None if None in longest else sum(duration for duration in longest if duration is not None)
