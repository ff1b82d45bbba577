"""A position is saved under a name."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from orchestrator.model.fleet import MAX_DESCRIPTION
from orchestrator.model.names import POSITION_NAME
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.measured import MEASURED, MeasuredTarget, split_measured
from orchestrator.model.text.text_fields import SHOW_TEXT
from orchestrator.model.units import AxisQuantity, Quantity


class SavePosition(Step):
    """Save a position under a name, for later jobs: a contact, a given value, or where an axis stands. Nothing moves.
    An earlier saved one of this name is replaced."""

    do: Literal["save-position"] = "save-position"
    position: str = Field(pattern=rf"^{POSITION_NAME}$", description="Its name.")
    axes: dict[str, AxisQuantity | None] = Field(
        default={}, description="User positions by axis; null: where the axis stands, at rest and referenced."
    )
    measured: dict[str, MeasuredTarget] = MEASURED
    description: Annotated[str, SHOW_TEXT] | None = Field(
        default=None, max_length=MAX_DESCRIPTION, description="Without one, that of the earlier one stays."
    )

    UNSAID: ClassVar[frozenset[str]] = frozenset({"measured"})

    if TYPE_CHECKING:

        def __init__(
            self, *, position: str, axes: Mapping[str, Any], description: str | None = None, name: str | None = None
        ) -> None: ...

    @model_validator(mode="before")
    @classmethod
    def _split_measured(cls, fields: Any) -> Any:
        return split_measured(fields, "axes")

    @model_validator(mode="after")
    def _some_axes(self) -> "SavePosition":
        if not self.axes and not self.measured:
            raise ValueError("save-position needs `axes` with at least one axis")
        return self

    @property
    def named_axes(self) -> list[str]:
        return [*self.axes, *self.measured]

    @property
    def saved_position(self) -> str:
        return self.position

    @property
    def measured_targets(self) -> Mapping[str, MeasuredTarget]:
        return self.measured

    def with_measured(self, targets: Mapping[str, Quantity]) -> Self:
        return self.model_copy(update={"axes": {**self.axes, **targets}, "measured": {}})

    def complete_words(self, fields: list[str]) -> list[str]:
        return [*fields, *(f"{axis}={target.describe()}" for axis, target in self.measured.items())]

    @property
    def relative_axes(self) -> list[str]:
        return [axis for axis, value in self.axes.items() if value is None]

    def describe_relative(self, number: int, axes: str) -> str:
        return f"step {number} saves where {axes} stands"
