"""A path: axes move along lines, arcs and splines together, within a tolerance."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, cast

from pydantic import ConfigDict, Field, model_validator

from orchestrator.model.frame import MAX_COORDINATES
from orchestrator.model.paths.gcode_settings import GcodeSettings
from orchestrator.model.paths.packed import Pieces
from orchestrator.model.paths.pieces import Piece
from orchestrator.model.paths.source import PathSource
from orchestrator.model.paths.spec import PathSpec
from orchestrator.model.state import StartWish
from orchestrator.model.steps.armed_terms import describe_armed_obstacle
from orchestrator.model.steps.base import Align, OwnSkew, Step, StepSampling
from orchestrator.model.steps.points import MAX_SCAN_AXES
from orchestrator.model.steps.triggers import Triggers, check_step_triggers
from orchestrator.model.steps.words import describe_trigger
from orchestrator.model.units import Quantity


def _describe_path_axes(schema: dict[str, Any]) -> None:
    """In a file, the axes of a path that is in a file of its own may be a map from the names there."""
    axes = schema["properties"]["axes"]
    text = {"description": axes.pop("description"), "title": axes.pop("title", "Axes")}
    names_schema = {"type": "object", "additionalProperties": {"type": "string"}}
    schema["properties"]["axes"] = {"anyOf": [axes, names_schema], **text}
    schema["required"] = ["do", *(name for name in schema["required"] if name not in ("start", "pieces"))]


_RATE_UNITS = {"speed": "units/s", "acceleration": "units/s²", "jerk": "units/s³"}


class FollowPath(Step, PathSpec):
    """Move axes together along a path, without a stop where corners are rounded. How far they may be off it is known
    before they move."""

    model_config = ConfigDict(json_schema_extra=_describe_path_axes)

    moves: ClassVar[bool] = True
    is_swept: ClassVar[bool] = True
    is_motion: ClassVar[bool] = True
    rests: ClassVar[bool] = True
    plans_long: ClassVar[bool] = True
    follows_path: ClassVar[bool] = True
    UNSAID: ClassVar[frozenset[str]] = frozenset({"axes", "start", "pieces", "names", "gcode", "source"})

    do: Literal["path"] = "path"
    file: str | None = Field(
        default=None,
        min_length=1,
        max_length=4096,
        description="Instead of `pieces`: a file beside the job file with G-code, a table of points, or a joint "
        "trajectory. `axes` may map the names in it to axes: `{X: gantry.x}`. It is read where the job is submitted.",
    )
    gcode: GcodeSettings | None = Field(
        default=None,
        description="With a `file` of G-code: its dialect, and what stands for the machine it was made for.",
    )
    names: list[str] = Field(
        default=[], max_length=MAX_SCAN_AXES, description="With `file`: the names of `axes` there, in their order."
    )
    start: list[Quantity] = Field(
        default=[],
        max_length=MAX_COORDINATES,
        description="Where the path begins, and the axes stand; of G-code 0 without it, of tables none.",
    )
    pieces: Pieces = Field(default=[])
    source: PathSource | None = Field(
        default=None,
        description="What the pieces were made of, with their lines; written where a file of another program is read.",
    )
    tolerance: Quantity = Field(
        description="How far the axes may be off the path, in the first axis's unit or with one; a path that cannot be "
        "promised within it is refused. Corners `within` a distance are part of the path."
    )
    record: StepSampling | None = Field(
        default=None, description="Have controllers record positions by themselves, for the recording of the job."
    )
    start_class: StartWish = Field(default="auto", description="Start class to use instead of the best one.")
    align: Align = 0
    max_start_skew: OwnSkew = None
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
            if self.gcode is not None:
                raise ValueError("has `gcode`, which needs `file`; remove one of them")
            if self.names:
                raise ValueError("names in a file need `file`; write `axes` as a list")
        elif self.pieces:
            raise ValueError("has `file`, so `pieces` have no meaning; remove one of them")
        elif self.names and len(self.names) != len(self.axes):
            raise ValueError(f"has {len(self.names)} names for {len(self.axes)} axes; give one for each")
        return self

    @property
    def named_axes(self) -> list[str]:
        return list(self.axes)

    @property
    def absolute_axes(self) -> list[str]:
        return list(self.axes)

    @property
    def relative_axes(self) -> list[str]:
        return list(self.axes)  # it begins where its axes stand

    @property
    def placed_axes(self) -> list[str]:
        return list(self.axes)

    def describe_value(self, key: str, value: Any) -> str:
        """A bare number is of the first coordinate's unit, which only the fleet says."""
        if key in _RATE_UNITS and isinstance(value, int | float):
            return f"{key}={value:.9g} {_RATE_UNITS[key]}"
        return super().describe_value(key, value)

    def describe_relative(self, number: int, axes: str) -> str:
        return f"step {number}, a path, begins at the current position of {axes}"

    @property
    def frames(self) -> list[str]:
        return [] if self.frame is None else [self.frame]

    @property
    def trigger_outputs(self) -> list[str]:
        return [trigger.output for trigger in self.triggers]

    def find_armed_obstacle(self) -> str:
        return describe_armed_obstacle(aligns=bool(self.align), records=self.record is not None)

    @property
    def start_wish(self) -> StartWish:
        """The start class that it asks for."""
        return self.start_class

    @property
    def wants_start_at_once(self) -> bool:
        """Whether it must start as soon as its controller can: its bound counts from an agreed instant."""
        return False

    @property
    def agrees_start(self) -> bool:
        """Whether its start needs an agreement."""
        return True

    @property
    def is_synchronised(self) -> bool:
        """Whether all axes take one duration."""
        return True

    @property
    def max_end_skew(self) -> int | None:
        """Its own limit of the end skew: it has none."""
        return None

    @property
    def max_path_skew(self) -> int | None:
        """Its own limit of the path skew: it has none, `tolerance` bounds more."""
        return None

    def complete_words(self, fields: list[str]) -> list[str]:
        pieces = "" if self.file else f", {len(self.pieces)} piece{'' if len(self.pieces) == 1 else 's'}"
        return [f"of {' '.join(self.axes)}{pieces}", *fields, *map(describe_trigger, self.triggers)]
