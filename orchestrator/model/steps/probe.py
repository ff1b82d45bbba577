"""An axis moves until an input changes, or to a position."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, WithJsonSchema, field_validator, model_validator

from orchestrator.model.fleet import Fleet
from orchestrator.model.names import Target, controller_of
from orchestrator.model.steps.base import Step, TargetResolver
from orchestrator.model.steps.speed import MANUAL, read_speed, scale_speed


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
    probes: ClassVar[bool] = True

    do: Literal["probe"] = "probe"
    to: dict[str, Target] = Field(
        min_length=1,
        description="The axis and where it goes at most: a quantity, or the name of a position.",
    )
    until: str = Field(description="controller.input, of the same controller as the axis.")
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
            to: Mapping[str, float | str],
            until: str,
            speed: float | str,
            name: str | None = None,
            **more: Any,
        ) -> None: ...

    @field_validator("to")
    @classmethod
    def _one_axis(cls, to: dict[str, Any]) -> dict[str, Any]:
        if len(to) > 1:
            raise ValueError(f"a probe moves one axis, not {len(to)} ({', '.join(to)}); write one probe for each")
        return to

    @model_validator(mode="after")
    def _one_controller(self) -> "Probe":
        if controller_of(self.axis) != controller_of(self.until):
            raise ValueError(f"{self.until} cannot stop {self.axis}: name an input of the same controller")
        return self

    @property
    def axis(self) -> str:
        """The axis that it moves."""
        return next(iter(self.to))

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
        return [self.until]

    def slow_down(self, rate: float, fleet: Fleet) -> Self:
        speed = fleet.axis(self.axis).manual_speed if self.speed == MANUAL else self.speed
        return self.model_copy(update={"speed": scale_speed(speed, rate)})

    def iterate_targets(self) -> Iterator[tuple[str, Target]]:
        yield from self.to.items()

    def resolve_targets(self, resolver: TargetResolver) -> Self:
        return self.model_copy(
            update={"to": {axis: resolver.find_target(axis, target) for axis, target in self.to.items()}}
        )
