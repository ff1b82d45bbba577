"""The job file: a list of steps for the whole fleet."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, WithJsonSchema, field_validator, model_validator

from orchestrator.model.base import Model
from orchestrator.model.duration import Duration
from orchestrator.model.names import ALL_AXES, is_position_name
from orchestrator.model.numbers import Part
from orchestrator.model.state import StartWish
from orchestrator.model.units import Quantity, check_quantity

UNKNOWN_ACTOR = "unknown"
_MISSING: Any = object()

_NUMBER_OR_TEXT: dict[str, Any] = {"anyOf": [{"type": "number"}, {"type": "string"}]}
ParameterText = Annotated[str, Field(max_length=120)]

Axes = Annotated[list[str], Field(min_length=1, description="Axes `controller.axis`, groups, or controllers.")]


def _require_in_files(name: str) -> Callable[[dict[str, Any]], None]:
    """Keep a field that has a default in Python required in the JSON Schema of files."""

    def add(schema: dict[str, Any]) -> None:
        schema["required"] = [name, *schema.get("required", [])]

    return add


class StepBase(Model):
    """Fields that every step may have."""

    model_config = ConfigDict(json_schema_extra=_require_in_files("do"))

    name: str | None = Field(default=None, max_length=80, description="Shown in progress and report.")


def _check_target(value: object) -> object:
    return value if is_position_name(value) else check_quantity(value)


Target = Annotated[int | float | str, BeforeValidator(_check_target), WithJsonSchema(_NUMBER_OR_TEXT)]
"""A quantity; or the name of a position, which stands for its value for that axis."""


def _read_whole_position(to: object) -> object:
    """`to: sample` stands for all axes of that position."""
    return {ALL_AXES: to} if is_position_name(to) else to


class Move(StepBase):
    """Move axes together: they start at one instant and, with `sync: time` or `phase`, end at one instant."""

    do: Literal["move"] = "move"
    to: Annotated[
        dict[str, Target],
        BeforeValidator(_read_whole_position),
        WithJsonSchema(
            {"anyOf": [{"type": "object", "additionalProperties": _NUMBER_OR_TEXT}, {"type": "string"}], "default": {}}
        ),
    ] = Field(
        default={},
        description="Absolute targets by axis: quantities, or names of positions; or one name, for all its axes.",
    )
    by: dict[str, Quantity] = Field(default={}, description="Relative moves by axis.")
    speed: Part = Field(default=1.0, description="Fraction of each axis's velocity limit.")
    sync: Literal["time", "phase", "none"] = Field(
        default="time",
        description="time: all end together; phase: a straight line in axis space; none: each axis takes its "
        "shortest time.",
    )
    ramps: Literal["common", "own"] = Field(
        default="common",
        description="Trapezoidal profiles under `sync: time`: one ramp time for all axes, or each axis at its "
        "maximum acceleration.",
    )
    start: StartWish = Field(default="auto", description="Start class to use instead of the best one.")
    align: Duration = Field(
        default=0,
        ge=0,
        le=600 * 1_000_000_000,
        description="How long the start may be delayed to the moment at which the controllers' ticks coincide best.",
    )
    max_start_skew: Duration | None = Field(default=None, description="Overrides the job's value.")
    max_end_skew: Duration | None = Field(default=None, description="Overrides the job's value.")
    max_path_skew: Duration | None = Field(default=None, description="Overrides the job's value.")

    if TYPE_CHECKING:  # numbers and text, as in a file, for editors and type checkers

        def __init__(
            self,
            *,
            to: Mapping[str, float | str] | str = ...,
            by: Mapping[str, float | str] = ...,
            speed: float | str = 1.0,
            **more: Any,
        ) -> None: ...

    @model_validator(mode="after")
    def _targets(self) -> "Move":
        if ALL_AXES in self.to and not is_position_name(self.to[ALL_AXES]):
            raise ValueError(f"{self.to[ALL_AXES]} for all axes (`*`) must be the name of a position")
        if not self.to and not self.by:
            raise ValueError("a move needs `to` (absolute) or `by` (relative) with at least one axis")
        twice = sorted(self.to.keys() & self.by.keys())
        if twice:
            raise ValueError(f"{', '.join(twice)} is in both `to` and `by`; an axis has one target")
        return self


class Home(StepBase):
    """Find the reference of axes; without `axes`, of the whole fleet in its `home_order`."""

    do: Literal["home"] = "home"
    axes: Axes | None = None


class Enable(StepBase):
    """Switch motors on."""

    do: Literal["enable"] = "enable"
    axes: Axes


class Disable(StepBase):
    """Switch motors off."""

    do: Literal["disable"] = "disable"
    axes: Axes


class SetPosition(StepBase):
    """Set the current position of axes to the given user positions; null removes an axis's offset. Nothing moves."""

    do: Literal["set-position"] = "set-position"
    axes: dict[str, Quantity | None] = Field(min_length=1, description="User positions by axis.")

    if TYPE_CHECKING:

        def __init__(self, *, axes: Mapping[str, float | str | None], name: str | None = None) -> None: ...


class Dwell(StepBase):
    """Wait."""

    do: Literal["dwell"] = "dwell"
    duration: Duration

    if TYPE_CHECKING:

        def __init__(self, *, duration: str, name: str | None = None) -> None: ...


class SetOutput(StepBase):
    """Switch a named output."""

    do: Literal["output"] = "output"
    output: str = Field(description="controller.output")
    value: bool = Field(description="true: active")


class WaitInput(StepBase):
    """Wait for a named input."""

    do: Literal["wait"] = "wait"
    input: str = Field(description="controller.input")
    value: bool = Field(default=True, description="true: active")
    timeout: Duration

    if TYPE_CHECKING:

        def __init__(self, *, input: str, timeout: str, value: bool = True, name: str | None = None) -> None: ...


Step = Annotated[
    Move | Home | Enable | Disable | SetPosition | Dwell | SetOutput | WaitInput, Field(discriminator="do")
]


def named_axes(step: Step) -> list[str]:
    """The axes, groups and controllers that a step names; none for a homing of the whole fleet, and for the axes that
    only a position names."""
    if isinstance(step, Move):
        return [axis for axis in (*step.to, *step.by) if axis != ALL_AXES]
    if isinstance(step, Home | Enable | Disable):
        return step.axes or []
    return list(step.axes) if isinstance(step, SetPosition) else []


class Job(Model):
    """A sequence of steps that a user submits to the fleet.

    In Python: `Job("scan", [Home(), Move(to={"gantry.x": 120, "stage.u": "6 mm"})], max_start_skew="5 ms")`; skews and
    durations are text with a unit. Raises `pydantic.ValidationError` with every mistake.
    """

    model_config = ConfigDict(json_schema_extra=_require_in_files("schema"))

    schema_: Literal["tutti.job/1"] = Field(default="tutti.job/1", alias="schema")
    name: str = Field(min_length=1, max_length=120)
    actor: str = Field(
        default=UNKNOWN_ACTOR, min_length=1, max_length=80, description="The user or program that submits the job."
    )
    max_start_skew: Duration = Field(default=10_000_000, description="Maximum spread of the axes' starts.")
    max_end_skew: Duration | None = Field(
        default=None,
        description="Maximum spread of the axes' ends. Without it, durations must match within 20 ms, apart from "
        "clock error.",
    )
    max_path_skew: Duration | None = Field(
        default=None, description="Maximum time offset between axes along their path."
    )
    parameters_used: dict[str, ParameterText] = Field(
        default={},
        max_length=100,
        description="The parameters of the template that the job was made of, with their values; they are written "
        "there when it is filled, and change nothing.",
    )
    steps: list[Step] = Field(min_length=1, max_length=10_000)

    def __init__(self, name: str = _MISSING, steps: Sequence["Step"] = _MISSING, **fields: Any) -> None:
        given = {"name": name, "steps": steps}
        super().__init__(**{key: value for key, value in given.items() if value is not _MISSING}, **fields)

    # Validation fills the fields itself, as for a model without a constructor of its own.
    __init__.__pydantic_base_init__ = True  # pyright: ignore[reportFunctionMemberAccess]

    @field_validator("max_start_skew", "max_end_skew", "max_path_skew")
    @classmethod
    def _above_zero(cls, value: int | None) -> int | None:
        if value is not None and value <= 0:
            raise ValueError("must be above 0")
        return value
