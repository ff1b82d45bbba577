"""An input captures the position of an axis."""

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, model_validator

from orchestrator.model.names import controller_of
from orchestrator.model.numbers import Duration
from orchestrator.model.steps.base import Step


class Latch(Step):
    """Arm the position latch of an axis, and wait until an input has captured its position."""

    do: Literal["latch"] = "latch"
    axis: str = Field(description="controller.axis")
    input: str = Field(description="controller.input, the latch input of that axis.")
    timeout: Annotated[Duration, Field(gt=0)]

    if TYPE_CHECKING:

        def __init__(self, *, axis: str, input: str, timeout: str, name: str | None = None) -> None: ...

    @model_validator(mode="after")
    def _one_controller(self) -> "Latch":
        if controller_of(self.axis) != controller_of(self.input):
            raise ValueError(f"{self.input} cannot latch {self.axis}: name an input of the same controller")
        return self

    @property
    def named_axes(self) -> list[str]:
        return [self.axis]

    @property
    def awaited_inputs(self) -> list[str]:
        return [self.input]
