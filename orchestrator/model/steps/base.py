"""What every kind of step answers about itself, and the fields that several kinds share."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Protocol, Self

from pydantic import ConfigDict, Field, PrivateAttr

from orchestrator.model.base import Model
from orchestrator.model.compensation import Approach
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import Target
from orchestrator.model.numbers import Duration
from orchestrator.model.paths.origin import PathOrigin
from orchestrator.model.script import ScriptModel
from orchestrator.model.steps.armed_terms import ArmedTerms
from orchestrator.model.steps.measured import MeasuredTarget
from orchestrator.model.steps.speed import MANUAL, Speed, scale_speed
from orchestrator.model.steps.words import describe_field
from orchestrator.model.text.text_fields import PLAIN_TEXT
from orchestrator.model.units import Quantity

Axes = Annotated[list[str], Field(min_length=1, description="Axes `controller.axis`, groups, or controllers.")]


def require_in_files(name: str) -> Callable[[dict[str, Any]], None]:
    """Keep a field that has a default in Python required in the JSON Schema of files."""

    def add(schema: dict[str, Any]) -> None:
        schema["required"] = [name, *schema.get("required", [])]

    return add


class TargetResolver(Protocol):
    """Replaces names of positions by quantities. Each method raises `Refusal` for a name without a value."""

    def find_target(self, axis: str, target: Quantity) -> Quantity:
        """The quantity of one target of `axis`."""
        ...

    def resolve_step(self, step: "Step") -> "Step":
        """A step inside another one, with quantities for names of positions."""
        ...

    def find_whole(self, name: str) -> Mapping[str, Quantity]:
        """The values of all axes of a position, by axis; `{"*": name}` for a position that is resolved later."""
        ...


@dataclass(frozen=True, slots=True)
class InnerSteps:
    """Steps inside a step. key: its field that holds them. times: how often they run. word: what a run is called."""

    key: str
    steps: "Sequence[Step]"
    times: int
    word: str


class Step(ScriptModel):
    """A step of a job: the fields that every kind has, and the questions that a kind answers about itself.

    A kind has a field `do` with its name in files. What a method here returns is right for a kind that neither moves
    nor switches anything; a kind overrides what is different for it.
    """

    model_config = ConfigDict(json_schema_extra=require_in_files("do"))

    moves: ClassVar[bool] = False
    """Whether it moves axes; the fleet file may say that they are enabled for that."""
    is_motion: ClassVar[bool] = False
    """Whether it is one motion with an agreed start: planned as a whole, armed, held, and continued."""
    rests: ClassVar[bool] = False
    """Whether this motion begins and ends at rest, so that no motion is loaded behind or before it."""
    enables: ClassVar[bool] = False
    """Whether it enables its axes."""
    is_swept: ClassVar[bool] = False
    """Whether it is known ahead where its axes may be while it moves them, so that it is checked against zones; steps
    of another kind move no axes of zones."""
    searches: ClassVar[bool] = False
    """Whether it finds the references of its axes."""
    probes: ClassVar[bool] = False
    """Whether it moves an axis until an input changes."""
    sets_positions: ClassVar[bool] = False
    """Whether it counts its axes anew, where they stand."""
    plans_long: ClassVar[bool] = False
    """Whether its plan can take so long that heartbeats must go on meanwhile."""
    follows_path: ClassVar[bool] = False
    """Its speed is changed along its path, while it moves."""
    acts: ClassVar[bool] = False
    """Whether it waits for a controller that does something."""
    is_open: ClassVar[bool] = False
    """Whether what it runs is asked for while it runs, so that it is the only step of its job."""

    name: Annotated[str, PLAIN_TEXT] | None = Field(
        default=None, max_length=80, description="Shown in progress and report."
    )
    _origin: PathOrigin | None = PrivateAttr(default=None)  # it is not sent

    @property
    def kind(self) -> str:
        """Its name in files: the value of `do`."""
        return str(type(self).model_fields["do"].default)

    # Structure

    @property
    def inner(self) -> InnerSteps | None:
        """The steps inside it."""
        return None

    @property
    def is_single(self) -> bool:
        """Whether the report has one entry for it, however many steps run."""
        return True

    @property
    def step_count(self) -> int:
        """How many steps run for it: all passes, and all points with the steps at them."""
        return 1

    @property
    def report_count(self) -> int:
        """How many entries of the report it has: every step of every pass; a scan is one."""
        return 1

    def iterate_written(self) -> "Iterator[Step]":
        """All steps as they are written, in the order in which they begin: for a repeat those inside it, after a scan
        those at each of its points."""
        yield self

    def replace_steps(self, replacements: "Mapping[int, Step]") -> "Step":
        """The step that stands in its place. replacements: by the `id` of the step that they replace, also inside
        repeats."""
        return replacements.get(id(self), self)

    @property
    def origin(self) -> PathOrigin | None:
        """Where it, or each of its pieces, stands in the file that it was made of; None: it was made of none, or was
        sent."""
        return self._origin

    def with_origin(self, origin: PathOrigin) -> Self:
        """The step with its place, or the places of its pieces, in a file."""
        step = self.model_copy()
        step._origin = origin  # noqa: SLF001
        return step

    # Axes, outputs, inputs

    @property
    def named_axes(self) -> list[str]:
        """The axes, groups and controllers that it names itself; none for a homing of the whole fleet, and for the axes
        that only a position names."""
        return []

    def find_axes(self, fleet: Fleet) -> list[str]:
        """The axes that it moves, switches or sets: those that its job must lease. Raises `UnknownName`."""
        del fleet
        return self.named_axes

    @property
    def uses_whole_fleet(self) -> bool:
        """Whether it means all axes of the fleet, in the order of the fleet file."""
        return False

    @property
    def absolute_axes(self) -> list[str]:
        """Axes with absolute targets; `*` for those of a position."""
        return []

    @property
    def relative_axes(self) -> list[str]:
        """Axes that it moves, or counts, from where they stand."""
        return []

    @property
    def placed_axes(self) -> list[str]:
        """Axes that later steps do not find where the job found them."""
        return []

    def describe_relative(self, number: int, axes: str) -> str:
        """What it does, as step `number`, from 1, with `axes` from where they stand. axes: some of `relative_axes`."""
        return f"step {number} depends on where {axes} stands"

    def slow_down(self, rate: float, fleet: Fleet) -> Self:
        """The step at `rate` times its speed, above 0 to 1; itself where it has none."""
        del rate, fleet
        return self

    @property
    def asked_approach(self) -> Approach | None:
        """From which side it asks its axes to end at their targets; None: as the fleet file says."""
        return None

    @property
    def frames(self) -> list[str]:
        """The frames of the fleet file that it uses."""
        return []

    @property
    def switched_outputs(self) -> list[str]:
        """The outputs that it switches at its turn."""
        return []

    @property
    def left_levels(self) -> dict[str, bool]:
        """The levels at which it leaves the outputs that it switches at its turn."""
        return {}

    @property
    def trigger_outputs(self) -> list[str]:
        """The outputs that it switches on the way."""
        return []

    @property
    def awaited_inputs(self) -> list[str]:
        """The inputs that it waits for."""
        return []

    @property
    def pause_ns(self) -> int | None:
        """How long it lasts between two motions; None for a step behind which the next motion begins from rest."""
        return None

    @property
    def can_join(self) -> bool:
        """Whether it can be one step together with another one."""
        return False

    def join_step(self, other: "Step") -> "Step | None":
        """One step that does both at once; None where they must stay two."""
        del other
        return None

    @property
    def armed_terms(self) -> ArmedTerms | None:
        """The terms on which it has the motion directly behind it wait armed."""
        return None

    @property
    def can_wait_armed(self) -> bool:
        """Whether it is, or begins with, a motion that may wait armed behind a step that says so."""
        return self.is_motion

    def find_armed_obstacle(self) -> str:
        """Why this motion cannot wait armed, with a remedy; empty: it can."""
        return ""

    @property
    def has_unread_points(self) -> bool:
        """Whether its points are still in a file, or in a form that is read where the job is submitted."""
        return False

    # Targets

    def iterate_targets(self) -> Iterator[tuple[str, Target]]:
        """Its own absolute targets as they are written, each with its axis."""
        yield from ()

    def resolve_targets(self, resolver: TargetResolver) -> Self:
        """The step with quantities for names of positions. Raises `Refusal`."""
        del resolver
        return self

    @property
    def measured_targets(self) -> Mapping[str, MeasuredTarget]:
        """Its targets that earlier steps measure, by axis."""
        return {}

    def with_measured(self, targets: Mapping[str, Quantity]) -> Self:
        """The step with quantities for what was measured. targets: by axis, all of `measured_targets`."""
        del targets
        return self

    @property
    def saved_position(self) -> str | None:
        """The name of the position that it saves."""
        return None

    @property
    def contact_names(self) -> Mapping[str, str]:
        """How later steps name what it measures, and the axis of each."""
        return {}

    # Words

    UNSAID: ClassVar[frozenset[str]] = frozenset()
    """Fields that `describe` does not list."""

    def describe_value(self, key: str, value: Any) -> str:
        """One field and its value."""
        return describe_field(key, value)

    def describe(self) -> str:
        """What its file says, without defaults: `move to gantry.x=120 stage.u=6, speed=0.5`. Of a repeat only how many
        steps it has."""
        exclusions = {"do", "name", "steps", "triggers", *self.UNSAID}
        fields = self.model_dump(mode="json", exclude_defaults=True, exclude=exclusions)
        words = self.complete_words([self.describe_value(key, value) for key, value in fields.items()])
        return " ".join(part for part in (self.kind, self.name and f"'{self.name}'", ", ".join(words)) if part)

    def complete_words(self, fields: list[str]) -> list[str]:
        """The parts of its description. fields: those of its fields that are not in `UNSAID`."""
        return fields


class AxesStep(Step):
    """A step with axes that are groups and controllers, too."""

    @property
    def named_axes(self) -> list[str]:
        axes: list[str] | None = getattr(self, "axes", None)
        return list(axes or [])

    def find_axes(self, fleet: Fleet) -> list[str]:
        return fleet.expand_names(self.named_axes or list(fleet.controllers))


Align = Annotated[
    Duration,
    Field(
        ge=0,
        le=600 * 1_000_000_000,
        description="How long the start may be delayed to the moment at which the controllers' ticks coincide best.",
    ),
]
OwnSkew = Annotated[Duration | None, Field(description="Overrides the job's value.")]


MoveStart = Literal["auto", "clock", "line", "sync", "host", "agreed", "at_once"]
"""When a move starts: at a T0 that is agreed ahead, by the best or a named start class; or as soon as its controller
can."""


class MotionOptions(Step):
    """How axes move together."""

    moves: ClassVar[bool] = True
    is_swept: ClassVar[bool] = True

    def slow_down(self, rate: float, fleet: Fleet) -> Self:
        speed = self.speed
        if speed == MANUAL:
            speed = {axis: fleet.axis(axis).manual_speed for axis in self.find_axes(fleet)}
        return self.model_copy(update={"speed": scale_speed(speed, rate)})

    speed: Speed = Field(
        default=1.0,
        description='A fraction of each axis\'s velocity limit (0.5, "50 %"); a speed ("5 mm/s") of the one axis, or '
        "along the straight line of axes with like units; one of both by axis ({gantry.x: 5 mm/s}), the others at "
        "their limits; or `manual`: `manual_speed` of each axis.",
    )
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
    start: MoveStart = Field(
        default="auto",
        description="at_once: as soon as the one controller of the step can; agreed: at an instant agreed ahead; or "
        "the start class to use instead of the best one.",
    )
    align: Align = 0
    max_start_skew: OwnSkew = None
    max_end_skew: OwnSkew = None
    max_path_skew: OwnSkew = None


class StepSampling(Model):
    """Positions that controllers record by themselves while a step moves, more densely than they can be polled."""

    axes: Axes
    period: Duration = Field(
        default=2_000_000, gt=0, description="Longest time between two samples; controllers use the next shorter one."
    )
