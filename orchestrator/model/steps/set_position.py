"""The user position of axes is set."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from orchestrator.model.steps.base import Step
from orchestrator.model.units import AxisQuantity


class SetPosition(Step):
    """Set the current position of axes to the given user positions; null removes an axis's offset. Nothing moves."""

    do: Literal["set-position"] = "set-position"
    axes: dict[str, AxisQuantity | None] = Field(min_length=1, description="User positions by axis.")

    if TYPE_CHECKING:

        def __init__(self, *, axes: Mapping[str, float | str | None], name: str | None = None) -> None: ...

    @property
    def named_axes(self) -> list[str]:
        return list(self.axes)

    @property
    def relative_axes(self) -> list[str]:
        # Later targets of these axes are counted from here.
        return [axis for axis, value in self.axes.items() if value is not None]

    @property
    def placed_axes(self) -> list[str]:
        return self.relative_axes

    def describe_relative(self, number: int, axes: str) -> str:
        return f"step {number} sets the position of {axes}, at the current position"
