"""Outputs are switched, and inputs are waited for."""

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field, field_validator

from orchestrator.model.numbers import Duration
from orchestrator.model.steps.base import Step


class SetOutput(Step):
    """Switch a named output; with `pulse`, back after that time."""

    acts: ClassVar[bool] = True

    do: Literal["output"] = "output"
    output: str = Field(description="controller.output")
    value: bool = Field(description="true: active")
    pulse: Duration | None = Field(
        default=None, description="It is switched to the other value after this time; the step ends then."
    )

    @field_validator("pulse")
    @classmethod
    def _above_zero(cls, value: int | None) -> int | None:
        if value == 0:
            raise ValueError("a pulse must be longer than 0")
        return value

    if TYPE_CHECKING:

        def __init__(self, *, output: str, value: bool, pulse: str | None = None, name: str | None = None) -> None: ...

    @property
    def switched_outputs(self) -> list[str]:
        return [self.output]

    @property
    def left_levels(self) -> dict[str, bool]:
        return {self.output: self.value == (self.pulse is None)}

    @property
    def pause_ns(self) -> int:
        return self.pulse or 0


class WaitInput(Step):
    """Wait for a named input."""

    do: Literal["wait"] = "wait"
    input: str = Field(description="controller.input")
    value: bool = Field(default=True, description="true: active")
    timeout: Duration

    if TYPE_CHECKING:

        def __init__(self, *, input: str, timeout: str, value: bool = True, name: str | None = None) -> None: ...

    @property
    def awaited_inputs(self) -> list[str]:
        return [self.input]
