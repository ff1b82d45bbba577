"""How a scan flies: its innermost axis passes the points of a line at constant speed."""

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from orchestrator.model.duration import Duration
from orchestrator.model.paths.pieces import Rate
from orchestrator.model.script import ScriptModel
from orchestrator.model.triggers import Trigger
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

    @field_validator("output")
    @classmethod
    def _named(cls, value: str) -> str:
        Trigger(output=value, every="1 ms")  # raises for what is no output
        return value


class FlyOptions(ScriptModel):
    """How fast a scan flies through the window of each point: from half of the way from the point before to half of
    the way to the next one."""

    duration: Duration | None = Field(default=None, description="The time in the window of each point.")
    speed: Rate | None = Field(
        default=None, description="Instead of `duration`: the speed of the innermost axis, in units/s or with a unit."
    )
    tolerance: Quantity | None = Field(
        default=None,
        description="How far the axis may be off its plan; a quarter of a window without it. A line that cannot be "
        "promised within it is refused.",
    )
    trigger: FlyTrigger | None = Field(default=None, description="A pulse in the window of each point.")
    repeat_disturbed: int = Field(
        default=0,
        ge=0,
        le=100,
        description="How often in a scan windows are flown again that were disturbed because a part of the motion came "
        "too late; otherwise their rows are not good.",
    )

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.duration is None) == (self.speed is None):
            raise ValueError("`fly` needs either `duration`, the time at each point, or `speed`")
        if self.duration is not None and self.duration < LEAST_WINDOW_NS:
            raise ValueError(f"`fly`: a `duration` of {self.duration / 1e6:g} ms is too short; the least is 1 ms")
        return self

    def describe(self) -> str:
        """In words: `flown, 20 ms a point`."""
        if self.duration is not None:
            words = f"flown, {self.duration / 1e6:g} ms a point"
        else:
            words = f"flown, at {self.speed}" + ("" if isinstance(self.speed, str) else " units/s")
        trigger = self.trigger
        return words if trigger is None else f"{words}, {trigger.output} at the {trigger.at} of each"
