"""An axis moves until an input changes, or to a position."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from orchestrator.model.fleet import Fleet
from orchestrator.model.names import AxisTargets, Target, controller_of
from orchestrator.model.steps.base import Step, TargetResolver
from orchestrator.model.steps.measured import MEASURED, MeasuredTarget, name_contacts, split_measured
from orchestrator.model.steps.speed import MANUAL, read_speed, scale_speed
from orchestrator.model.units import AxisQuantity, Quantity

Direction = Literal["forward", "reverse"]
"""Of a limit switch, in the direction of the controller's counts."""


def _read_probe_speed(value: object) -> float | str:
    return MANUAL if value == MANUAL else read_speed(value, "speed")


ProbeSpeed = Annotated[
    float | str,
    BeforeValidator(_read_probe_speed),
    WithJsonSchema({"anyOf": [{"type": "number", "exclusiveMinimum": 0, "maximum": 1}, {"type": "string"}]}),
]


class Probe(Step):
    """Move an axis until an input changes, or to a position where it comes to rest without that. The report has the
    position at which the input changed, as an interval."""

    moves: ClassVar[bool] = True
    is_swept: ClassVar[bool] = True
    probes: ClassVar[bool] = True
    UNSAID: ClassVar[frozenset[str]] = frozenset({"measured"})

    do: Literal["probe"] = "probe"
    to: AxisTargets = Field(
        default={},
        description="The axis and where it goes at most: a quantity, or the name of a position.",
    )
    measured: dict[str, MeasuredTarget] = MEASURED
    start: dict[str, AxisQuantity] = Field(
        default={}, description="Where axes must stand before, within a count; nothing moves otherwise."
    )
    until: str = Field(
        description="controller.input, of the same controller as the axis; or controller.axis.forward or "
        "controller.axis.reverse: its own limit switch, as the state names it."
    )
    level: Literal["active", "passive"] = Field(
        default="active", description="What the input becomes; it must be the other one at the beginning."
    )
    speed: ProbeSpeed = Field(
        description='How fast it moves: "1 mm/s", a fraction of the velocity limit, or `manual`: `manual_speed` of the '
        "axis."
    )
    otherwise: Literal["fail", "continue"] = Field(
        default="fail", alias="else", description="What to do if the input has not changed up to there."
    )
    by: Literal["controller", "host"] = Field(
        default="controller",
        description="What stops the axis: its controller, or the computer that polls the input, later by far.",
    )

    if TYPE_CHECKING:

        def __init__(
            self,
            *,
            to: Mapping[str, Any],
            until: str,
            speed: float | str,
            name: str | None = None,
            **more: Any,
        ) -> None: ...

    @model_validator(mode="before")
    @classmethod
    def _split_measured(cls, fields: Any) -> Any:
        return split_measured(fields, "to")

    @model_validator(mode="after")
    def _one_axis(self) -> "Probe":
        axes = [*self.to, *self.measured]
        if len(axes) != 1:
            number = ", ".join(axes) or "none"
            raise ValueError(f"a probe moves one axis, and `to` has {len(axes)} ({number}); write one probe for each")
        if controller_of(self.axis) != controller_of(self.until):
            raise ValueError(f"{self.until} cannot stop {self.axis}: name an input of the same controller")
        if self.until.count(".") > 1 and self.limit is None:
            raise ValueError(f"{self.until} is no limit switch of {self.axis}: {self.axis}.forward or .reverse")
        if self.limit is not None and (self.level, self.by) != ("active", "controller"):
            raise ValueError(f"a limit switch stops {self.axis} by its controller, when it becomes active")
        return self

    @property
    def axis(self) -> str:
        """The axis that it moves."""
        return next(iter((*self.to, *self.measured)))

    @property
    def limit(self) -> Direction | None:
        """The limit switch that ends it; None: an input does."""
        return next((way for way in get_args(Direction) if self.until == f"{self.axis}.{way}"), None)

    @property
    def named_axes(self) -> list[str]:
        return [self.axis]

    @property
    def absolute_axes(self) -> list[str]:
        return [self.axis]

    @property
    def placed_axes(self) -> list[str]:
        return [self.axis]

    @property
    def awaited_inputs(self) -> list[str]:
        return [] if self.limit is not None else [self.until]

    @property
    def relative_axes(self) -> list[str]:
        # The direction, and the bounds of what it finds.
        return [self.axis]

    def describe_relative(self, number: int, axes: str) -> str:
        return f"step {number} probes with {axes} from the current position"

    def slow_down(self, rate: float, fleet: Fleet) -> Self:
        speed = fleet.axis(self.axis).manual_speed if self.speed == MANUAL else self.speed
        return self.model_copy(update={"speed": scale_speed(speed, rate)})

    @property
    def measured_targets(self) -> Mapping[str, MeasuredTarget]:
        return self.measured

    def with_measured(self, targets: Mapping[str, Quantity]) -> Self:
        return self.model_copy(update={"to": dict(targets), "measured": {}})

    @property
    def contact_names(self) -> list[str]:
        return name_contacts(self.name, self.axis)

    def iterate_targets(self) -> Iterator[tuple[str, Target]]:
        yield from self.to.items()

    def resolve_targets(self, resolver: TargetResolver) -> Self:
        return self.model_copy(
            update={"to": {axis: resolver.find_target(axis, target) for axis, target in self.to.items()}}
        )

    def complete_words(self, fields: list[str]) -> list[str]:
        return [*(f"to {axis}={target.describe()}" for axis, target in self.measured.items()), *fields]
