"""How a scan flies: its innermost axes pass the points of a line at constant speed."""

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from orchestrator.model.numbers import Duration
from orchestrator.model.paths.pieces import Rate
from orchestrator.model.script import ScriptModel
from orchestrator.model.steps.io import WaitInput
from orchestrator.model.steps.points import MAX_SCAN_AXES
from orchestrator.model.steps.triggers import Trigger
from orchestrator.model.units import Quantity

LEAST_WINDOW_NS = 1_000_000
"""The shortest window of a point: no controller plays samples that are closer."""

WindowPlace = Literal["start", "middle", "end"]


class FlyTrigger(ScriptModel):
    """A pulse at each point of a line that is flown."""

    output: str = Field(description="controller.output")
    at: WindowPlace = Field(default="middle", description="Where in the window of each point: its middle is the point.")
    pulse: Annotated[Duration, Field(gt=0)] | None = Field(
        default=None, description="How long the output is active each time, at least; 1 ms without it."
    )
    gate: bool = Field(
        default=False,
        description="true: active from the start of each window on, for its time without the detector's `dead_time`.",
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.gate and self.pulse is not None:
            raise ValueError("has `gate` and `pulse`; remove one of them")
        if self.gate and "at" in self.model_fields_set and self.at != "start":
            raise ValueError(f"a `gate` begins with each window; remove `at: {self.at}`")
        return self

    @field_validator("output")
    @classmethod
    def _named(cls, value: str) -> str:
        Trigger(output=value, every="1 ms")  # raises for what is no output
        return value


class FlyDetector(ScriptModel):
    """What a detector needs: windows of points are no shorter."""

    dead_time: Duration = Field(default=0, description="After each point, in which it takes nothing.")
    max_rate: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None, description="Points per second that it takes at most."
    )

    @model_validator(mode="after")
    def _states_something(self) -> Self:
        if self.max_rate is None and not self.dead_time:
            raise ValueError("`detector` needs `dead_time`, `max_rate` or both")
        return self

    @property
    def least_window_s(self) -> float:
        """The shortest window that it takes, s."""
        return max(1.0 / self.max_rate if self.max_rate else 0.0, self.dead_time / 1e9)


class FlyOptions(ScriptModel):
    """How fast a scan flies through the window of each point: from half of the way from the point before to half of
    the way to the next one."""

    axis: list[str] | None = Field(
        default=None,
        min_length=1,
        max_length=MAX_SCAN_AXES,
        description="Axes that fly together along a line, the last of `axes`, with as many points each; the "
        "last one alone without it.",
    )
    duration: Duration | None = Field(
        default=None,
        description="The time in the window of each point; without it and without `speed` the shortest that the axis "
        "and the `detector` allow.",
    )
    speed: Rate | None = Field(
        default=None,
        description="Instead of `duration`: the speed of the innermost axis, of several together along their line, in "
        "units/s or with a unit.",
    )
    tolerance: Quantity | None = Field(
        default=None,
        description="How far the axis may be off its plan; a quarter of a window without it. A line that cannot be "
        "promised within it is refused.",
    )
    trigger: FlyTrigger | None = Field(default=None, description="A pulse, or a gate, in the window of each point.")
    detector: FlyDetector | None = Field(default=None, description="What is to take the points.")
    wait: WaitInput | None = Field(
        default=None,
        description="An input that is waited for before each line, as of a detector that is ready; each line is a "
        "motion of its own then.",
    )
    repeat_disturbed: int = Field(
        default=0,
        ge=0,
        le=100,
        description="How often in a scan windows are flown again that were disturbed because a part of the motion came "
        "too late; otherwise their rows are not good.",
    )

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if self.duration is not None and self.speed is not None:
            raise ValueError("`fly` has `duration`, the time at each point, and `speed`; remove one of them")
        detector = self.detector
        is_fastest, has_rate = self.duration is None and self.speed is None, bool(detector and detector.max_rate)
        if is_fastest and self.trigger is not None and not has_rate:
            raise ValueError(
                "`fly`: how fast the output can be switched is known to its controller alone; write `duration`, "
                "`speed`, or `detector: {max_rate: …}`"
            )
        if self.trigger is not None and self.trigger.gate and not (detector and detector.dead_time):
            raise ValueError("`fly`: a `gate` needs `detector: {dead_time: …}`; without it, it would not end in a line")
        if self.duration is not None and self.duration < LEAST_WINDOW_NS:
            raise ValueError(f"`fly`: a `duration` of {self.duration / 1e6:g} ms is too short; the least is 1 ms")
        return self

    def describe(self, way: str = "one line") -> str:
        """In words: `flown, 20 ms a point`. way: along which several axes fly together."""
        words = "flown"
        if self.axis is not None and len(self.axis) > 1:
            words += f" by {', '.join(self.axis)} along {way}"
        if self.duration is not None:
            words += f", {self.duration / 1e6:g} ms a point"
        elif self.speed is None:
            words += ", as fast as its axes and the detector allow"
        else:
            words += f", at {self.speed}" + ("" if isinstance(self.speed, str) else " units/s")
        if self.wait is not None:
            words += f", waits for {self.wait.input} before each line"
        trigger = self.trigger
        if trigger is None:
            return words
        place_words = "in the window" if trigger.gate else f"at the {trigger.at}"
        return f"{words}, {trigger.output} {place_words} of each"
