"""The user position of axes is set."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from orchestrator.model.steps.base import Step
from orchestrator.model.steps.measured import MEASURED, MeasuredTarget, split_measured
from orchestrator.model.units import AxisQuantity, Quantity


class SetPosition(Step):
    """Set the current position of axes to the given user positions; null removes an axis's offset. Nothing moves."""

    sets_positions: ClassVar[bool] = True

    do: Literal["set-position"] = "set-position"
    axes: dict[str, AxisQuantity | None] = Field(default={}, description="User positions by axis.")
    measured: dict[str, MeasuredTarget] = MEASURED

    UNSAID: ClassVar[frozenset[str]] = frozenset({"measured"})

    if TYPE_CHECKING:

        def __init__(self, *, axes: Mapping[str, Any], name: str | None = None) -> None: ...

    @model_validator(mode="before")
    @classmethod
    def _split_measured(cls, fields: Any) -> Any:
        return split_measured(fields, "axes")

    @model_validator(mode="after")
    def _some_axes(self) -> "SetPosition":
        if not self.axes and not self.measured:
            raise ValueError("set-position needs `axes` with at least one axis")
        return self

    @property
    def named_axes(self) -> list[str]:
        return [*self.axes, *self.measured]

    @property
    def measured_targets(self) -> Mapping[str, MeasuredTarget]:
        return self.measured

    def with_measured(self, targets: Mapping[str, Quantity]) -> Self:
        return self.model_copy(update={"axes": {**self.axes, **targets}, "measured": {}})

    def complete_words(self, fields: list[str]) -> list[str]:
        return [*fields, *(f"{axis}={target.describe()}" for axis, target in self.measured.items())]

    @property
    def relative_axes(self) -> list[str]:
        # Later targets of these axes are counted from here.
        return [*(axis for axis, value in self.axes.items() if value is not None), *self.measured]

    @property
    def placed_axes(self) -> list[str]:
        return self.relative_axes

    def describe_relative(self, number: int, axes: str) -> str:
        return f"step {number} sets the position of {axes}, at the current position"
