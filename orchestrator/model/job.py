"""The job file: a list of steps for the whole fleet."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, cast

from pydantic import ConfigDict, Field, field_validator, model_validator

from orchestrator.model.base import Model
from orchestrator.model.duration import Duration
from orchestrator.model.names import ALL_AXES, MoveTarget, is_position_name
from orchestrator.model.numbers import Part
from orchestrator.model.path import MAX_COORDINATES, MAX_PIECES, PathSpec, Piece
from orchestrator.model.scan import MAX_POINTS, MAX_SCAN_AXES, GridPoints, PointTable, ScanAxis, ScanSpec
from orchestrator.model.state import StartWish
from orchestrator.model.triggers import Triggers, check_job_outputs, check_step_triggers
from orchestrator.model.units import Quantity

UNKNOWN_ACTOR = "unknown"
MAX_AT_EACH = 50  # steps at each point of a scan
MAX_REPEATED = 200  # steps inside a repeat, those at the points of its scans included
MAX_REPEAT_DEPTH = 3  # of repeats inside each other
_MISSING: Any = object()

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


_Align = Annotated[
    Duration,
    Field(
        ge=0,
        le=600 * 1_000_000_000,
        description="How long the start may be delayed to the moment at which the controllers' ticks coincide best.",
    ),
]
_OwnSkew = Annotated[Duration | None, Field(description="Overrides the job's value.")]


class MotionOptions(StepBase):
    """How axes move together."""

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
    align: _Align = 0
    max_start_skew: _OwnSkew = None
    max_end_skew: _OwnSkew = None
    max_path_skew: _OwnSkew = None


class StepSampling(Model):
    """Positions that controllers record by themselves while a step moves, more densely than they can be polled."""

    axes: Axes
    period: Duration = Field(
        default=2_000_000, gt=0, description="Longest time between two samples; controllers use the next shorter one."
    )


class MoveTargets(StepBase):
    """Where axes move to."""

    do: Literal["move"] = "move"
    to: MoveTarget = Field(
        default={},
        description="Absolute targets by axis: quantities, or names of positions; or one name, for all its axes.",
    )
    by: dict[str, Quantity] = Field(default={}, description="Relative moves by axis.")
    record: StepSampling | None = Field(
        default=None, description="Have controllers record positions by themselves, for the recording of the job."
    )
    triggers: Triggers = Field(default=[], description="Outputs that are switched on the way.")


class Move(MotionOptions, MoveTargets):
    """Move axes together: they start at one instant and, with `sync: time` or `phase`, end at one instant."""

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
        check_step_triggers(self.triggers, [*self.to, *self.by])
        return self


def _describe_path_axes(schema: dict[str, Any]) -> None:
    """In a file, the axes of a path that is in a file of its own may be a map from the names there."""
    axes = schema["properties"]["axes"]
    text = {"description": axes.pop("description"), "title": axes.pop("title", "Axes")}
    named = {"type": "object", "additionalProperties": {"type": "string"}}
    schema["properties"]["axes"] = {"anyOf": [axes, named], **text}
    schema["required"] = ["do", *(name for name in schema["required"] if name not in ("start", "pieces"))]


class FollowPath(StepBase, PathSpec):
    """Move axes together along a path, without a stop where corners are rounded. How far they may be off it is known
    before they move."""

    model_config = ConfigDict(json_schema_extra=_describe_path_axes)

    do: Literal["path"] = "path"
    file: str | None = Field(
        default=None,
        min_length=1,
        max_length=4096,
        description="Instead of `pieces`: a file beside the job file with G-code, a table of points, or a joint "
        "trajectory. `axes` may map the names in it to axes: `{X: gantry.x}`. It is read where the job is submitted.",
    )
    names: list[str] = Field(
        default=[], max_length=MAX_SCAN_AXES, description="With `file`: the names of `axes` there, in their order."
    )
    start: list[Quantity] = Field(
        default=[],
        max_length=MAX_COORDINATES,
        description="Where the path begins, and the axes stand; of G-code 0 without it, of tables none.",
    )
    pieces: list[Piece] = Field(default=[], max_length=MAX_PIECES)
    tolerance: Quantity = Field(
        description="How far the axes may be off the path, in the first axis's unit or with one; a path that cannot be "
        "promised within it is refused. Corners `within` a distance are part of the path."
    )
    record: StepSampling | None = Field(
        default=None, description="Have controllers record positions by themselves, for the recording of the job."
    )
    start_class: StartWish = Field(default="auto", description="Start class to use instead of the best one.")
    align: _Align = 0
    max_start_skew: _OwnSkew = None
    triggers: Triggers = Field(default=[], description="Outputs that are switched on the way.")

    @model_validator(mode="after")
    def _check_triggers(self) -> "FollowPath":
        check_step_triggers(self.triggers, self.axes)
        return self

    if TYPE_CHECKING:

        def __init__(
            self,
            *,
            axes: Sequence[str] | Mapping[str, str],
            tolerance: float | str,
            start: Sequence[float | str] = (),
            pieces: Sequence[Mapping[str, Any] | Piece] = (),
            **more: Any,
        ) -> None: ...

    @model_validator(mode="before")
    @classmethod
    def _split_names(cls, data: Any) -> Any:
        """`axes: {X: gantry.x}` is `axes: [gantry.x]` and `names: [X]`."""
        if not isinstance(data, dict) or not isinstance(data.get("axes"), dict):  # pyright: ignore[reportUnknownMemberType]
            return data  # pyright: ignore[reportUnknownVariableType]
        plain = cast(dict[str, Any], data)
        axes = cast(dict[Any, Any], plain["axes"])
        return {**plain, "axes": list(axes.values()), "names": [str(name) for name in axes]}

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if self.file is None:
            if not self.start or not self.pieces:
                raise ValueError("needs `start` and `pieces`, or `file`")
            if self.names:
                raise ValueError("names in a file need `file`; write `axes` as a list")
        elif self.pieces:
            raise ValueError("has `file`, so `pieces` have no meaning; remove one of them")
        elif self.names and len(self.names) != len(self.axes):
            raise ValueError(f"has {len(self.names)} names for {len(self.axes)} axes; give one for each")
        return self


MOTION_STEPS = ("move", "path")
"""The kinds of steps that are motion steps themselves; a scan consists of moves."""


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
    """Switch a named output; with `pulse`, back after that time."""

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


class WaitInput(StepBase):
    """Wait for a named input."""

    do: Literal["wait"] = "wait"
    input: str = Field(description="controller.input")
    value: bool = Field(default=True, description="true: active")
    timeout: Duration

    if TYPE_CHECKING:

        def __init__(self, *, input: str, timeout: str, value: bool = True, name: str | None = None) -> None: ...


class Latch(StepBase):
    """Arm the position latch of an axis, and wait until an input has captured its position."""

    do: Literal["latch"] = "latch"
    axis: str = Field(description="controller.axis")
    input: str = Field(description="controller.input, the latch input of that axis.")
    timeout: Annotated[Duration, Field(gt=0)]

    if TYPE_CHECKING:

        def __init__(self, *, axis: str, input: str, timeout: str, name: str | None = None) -> None: ...

    @model_validator(mode="after")
    def _one_controller(self) -> "Latch":
        if self.axis.partition(".")[0] != self.input.partition(".")[0]:
            raise ValueError(f"{self.input} cannot latch {self.axis}: name an input of the same controller")
        return self


PointStep = Annotated[Move | Dwell | SetOutput | WaitInput, Field(discriminator="do")]

_NOT_AT_EACH = {
    "home": "it would take the reference away between two points; put it before the scan",
    "enable": "axes are switched before the scan; put it there",
    "disable": "the next point needs the axes; put it behind the scan",
    "path": "a scan stops at its points; put the path before or behind the scan",
    "latch": "the record of a scan has no place for it; put it before or behind the scan",
    "set-position": "it would shift the points after it; put it before the scan",
    "scan": "add its axes to `axes` of this scan instead",
    "repeat": "write its steps out, or repeat the scan",
}


class ScanPoints(StepBase):
    """Where a scan goes, and what it does there."""

    do: Literal["scan"] = "scan"
    axes: dict[str, ScanAxis] = Field(
        default={},
        max_length=MAX_SCAN_AXES,
        description="Nested axes, the outermost first; the last one moves fastest.",
    )
    points: PointTable | None = Field(default=None, description="A table of points, instead of `axes`.")
    scanspec: ScanSpec | None = Field(
        default=None, description="A scan in the JSON form of scanspec 1.x, instead of `axes`; needs `tutti[scanspec]`."
    )
    at_each: list[PointStep] = Field(
        default=[],
        max_length=MAX_AT_EACH,
        description="Steps at each point: moves of other axes, dwells, outputs, waits for an input.",
    )


class Scan(MotionOptions, ScanPoints):
    """Move axes from point to point, and stop at each. Positions are absolute."""

    if TYPE_CHECKING:

        def __init__(
            self,
            *,
            axes: Mapping[str, Mapping[str, Any] | ScanAxis] = ...,
            points: Mapping[str, Any] | PointTable | None = None,
            scanspec: Mapping[str, Any] | None = None,
            at_each: Sequence["Move | Dwell | SetOutput | WaitInput"] = (),
            speed: float | str = 1.0,
            **more: Any,
        ) -> None: ...

    @field_validator("at_each", mode="before")
    @classmethod
    def _allowed_at_points(cls, value: Any) -> Any:
        steps: list[Any] = list(value) if isinstance(value, list | tuple) else []  # pyright: ignore[reportUnknownArgumentType]
        for number, each in enumerate(steps):
            kind = str(each.get("do") if isinstance(each, dict) else getattr(each, "do", ""))  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]
            if kind in _NOT_AT_EACH:
                raise ValueError(f"step {number}: `do: {kind}` cannot stand in `at_each`: {_NOT_AT_EACH[kind]}")
        return value  # pyright: ignore[reportUnknownVariableType]

    @model_validator(mode="after")
    def _one_source(self) -> "Scan":
        if sum(bool(each) for each in (self.axes, self.points, self.scanspec)) != 1:
            raise ValueError("a scan needs one of `axes`, `points` and `scanspec`")
        for number, twice in find_moved_twice(self.axis_names, self.at_each):
            raise ValueError(
                f"at_each[{number}] moves {', '.join(twice)}, which the scan positions; move other axes there"
            )
        if self.point_count > MAX_POINTS:
            raise ValueError(f"has {self.point_count} points; the maximum is {MAX_POINTS}")
        return self

    @property
    def axis_names(self) -> list[str]:
        """The axes that it positions; none while they are in a file that was not read yet."""
        return list(self.axes) or ([] if self.points is None else self.points.axis_names)

    @property
    def point_count(self) -> int:
        """The number of points; 0 while they are in a file that was not read yet."""
        if self.axes:
            return GridPoints(self.axes).count
        return 0 if self.points is None else self.points.point_count

    def make_move(self, positions: Mapping[str, float]) -> Move:
        """The move to one point."""
        options = {name: getattr(self, name) for name in ("name", *MotionOptions.model_fields)}
        # Everything in it was validated with the scan.
        return Move.model_construct(to=dict(positions), **options)


class Repeat(StepBase):
    """Run steps several times."""

    do: Literal["repeat"] = "repeat"
    times: int = Field(ge=1, le=MAX_POINTS)
    steps: list["Step"] = Field(min_length=1, max_length=MAX_REPEATED)

    if TYPE_CHECKING:

        def __init__(self, *, times: int, steps: Sequence["Step"], name: str | None = None) -> None: ...

    @model_validator(mode="after")
    def _bounded(self) -> "Repeat":
        if _find_depth(self) > MAX_REPEAT_DEPTH:
            raise ValueError(f"repeats are nested more than {MAX_REPEAT_DEPTH} deep; write the innermost ones out")
        inside = sum(1 for _ in iterate_steps(self.steps))
        if inside > MAX_REPEATED:
            raise ValueError(f"has {inside} steps inside; the maximum is {MAX_REPEATED}")
        return self


Step = Annotated[
    Move | Home | Enable | Disable | SetPosition | Dwell | SetOutput | WaitInput | Latch | Scan | FollowPath | Repeat,
    Field(discriminator="do"),
]
Repeat.model_rebuild()


def _find_depth(step: Step) -> int:
    """How deep repeats are nested in a step."""
    return 1 + max(map(_find_depth, step.steps)) if isinstance(step, Repeat) else 0


def iterate_steps(steps: Iterable[Step]) -> Iterator[Step]:
    """All steps as they are written, in the order in which they begin: for a repeat those inside it, after a scan those
    at each of its points."""
    for step in steps:
        if isinstance(step, Repeat):
            yield from iterate_steps(step.steps)
        else:
            yield step
            if isinstance(step, Scan):
                yield from step.at_each


def named_axes(step: Step) -> list[str]:
    """The axes, groups and controllers that a step names itself; none for a homing of the whole fleet, and for the axes
    that only a position names."""
    if isinstance(step, Move):
        return [axis for axis in (*step.to, *step.by) if axis != ALL_AXES]
    if isinstance(step, Scan):
        return step.axis_names
    if isinstance(step, FollowPath):
        return list(step.axes)
    if isinstance(step, Home | Enable | Disable):
        return step.axes or []
    if isinstance(step, Latch):
        return [step.axis]
    return list(step.axes) if isinstance(step, SetPosition) else []


def list_trigger_outputs(step: Step) -> list[str]:
    """The outputs that a step switches on the way."""
    return [trigger.output for trigger in step.triggers] if isinstance(step, Move | FollowPath) else []


def find_moved_twice(axes: Iterable[str], at_each: Iterable[Step]) -> Iterator[tuple[int, list[str]]]:
    """The steps at the points of a scan that move what the scan positions: the number of each, and those axes. axes: of
    the scan."""
    scanned = set(axes)
    for number, step in enumerate(at_each):
        twice = sorted(scanned & set(named_axes(step)))
        if twice:
            yield number, twice


def find_scans(steps: Iterable[Step]) -> list[Scan]:
    """All scans as they are written."""
    return [step for step in iterate_steps(steps) if isinstance(step, Scan)]


def replace_scans(steps: Iterable[Step], replacements: Mapping[int, Scan]) -> list[Step]:
    """The steps with other scans. replacements: by the `id` of the scan."""
    return [
        step.model_copy(update={"steps": replace_scans(step.steps, replacements)})
        if isinstance(step, Repeat)
        else replacements.get(id(step), step)
        for step in steps
    ]


def find_digests(steps: Iterable[Step]) -> list[str]:
    """The digests of stored points that steps name, each once."""
    tables = [scan.points for scan in find_scans(steps)]
    return list(dict.fromkeys(each.digest for each in tables if each is not None and each.digest is not None))


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

    @model_validator(mode="after")
    def _separate_outputs(self) -> "Job":
        steps = list(iterate_steps(self.steps))
        check_job_outputs(steps, (step.output for step in steps if isinstance(step, SetOutput)))
        return self

    @field_validator("max_start_skew", "max_end_skew", "max_path_skew")
    @classmethod
    def _above_zero(cls, value: int | None) -> int | None:
        if value is not None and value <= 0:
            raise ValueError("must be above 0")
        return value
