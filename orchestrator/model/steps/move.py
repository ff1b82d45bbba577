"""A move: axes go to targets, and start at one instant."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from orchestrator.model.compensation import Approach
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import ALL_AXES, MoveTarget, Target, is_position_name
from orchestrator.model.state import StartWish
from orchestrator.model.steps.armed_terms import describe_armed_obstacle
from orchestrator.model.steps.base import MotionOptions, Step, StepSampling, TargetResolver
from orchestrator.model.steps.measured import MEASURED, MeasuredTarget, split_measured
from orchestrator.model.steps.speed import join_speeds
from orchestrator.model.steps.triggers import Triggers, check_step_triggers
from orchestrator.model.steps.words import describe_trigger
from orchestrator.model.units import AxisQuantity, Quantity

_LIKE_FIELDS = [name for name in MotionOptions.model_fields if name not in ("do", "name", "speed")]
"""What moves that are joined have in common."""
NAME_AXES = "name the axes of the position that are to move: `to: {axis: position}`"


class MoveTargets(Step):
    """Where axes move to."""

    is_motion: ClassVar[bool] = True
    UNSAID: ClassVar[frozenset[str]] = frozenset({"measured"})

    do: Literal["move"] = "move"
    to: MoveTarget = Field(
        default={},
        description="Absolute targets by axis: quantities, or names of positions; or one name, for all its axes.",
    )
    measured: dict[str, MeasuredTarget] = MEASURED
    by: dict[str, AxisQuantity] = Field(default={}, description="Relative moves by axis.")
    approach: Approach | None = Field(
        default=None,
        description="From which side its axes end at their targets, as `approach` of `backlash` in the fleet file, "
        "which is the default.",
    )
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
            speed: float | str | Mapping[str, float | str] = 1.0,
            **more: Any,
        ) -> None: ...

    @model_validator(mode="before")
    @classmethod
    def _split_measured(cls, fields: Any) -> Any:
        return split_measured(fields, "to")

    @model_validator(mode="after")
    def _targets(self) -> "Move":
        if ALL_AXES in self.to and not is_position_name(self.to[ALL_AXES]):
            raise ValueError(f"{self.to[ALL_AXES]} for all axes (`*`) must be the name of a position")
        if not self.to and not self.by and not self.measured:
            raise ValueError("a move needs `to` (absolute) or `by` (relative) with at least one axis")
        repetitions = sorted((self.to.keys() | self.measured.keys()) & self.by.keys())
        if repetitions:
            raise ValueError(f"{', '.join(repetitions)} is in both `to` and `by`; an axis has one target")
        check_step_triggers(self.triggers, [*self.to, *self.measured, *self.by])
        return self

    @property
    def asked_approach(self) -> Approach | None:
        return self.approach

    @property
    def named_axes(self) -> list[str]:
        return [axis for axis in (*self.to, *self.measured, *self.by) if axis != ALL_AXES]

    def find_axes(self, fleet: Fleet) -> list[str]:
        return fleet.find_real_axes(self.named_axes)

    @property
    def absolute_axes(self) -> list[str]:
        return [*self.to, *self.measured]

    @property
    def relative_axes(self) -> list[str]:
        return list(self.by)

    @property
    def placed_axes(self) -> list[str]:
        return [*self.to, *self.measured, *self.by]

    @property
    def can_join(self) -> bool:
        return not (self.triggers or self.record or self.name or self.measured or ALL_AXES in self.to)

    def join_step(self, other: Step) -> "Move | None":
        if not isinstance(other, Move) or not (self.can_join and other.can_join):
            return None
        are_alike = all(getattr(self, name) == getattr(other, name) for name in _LIKE_FIELDS)
        speed = join_speeds((self.speed, self.named_axes), (other.speed, other.named_axes))
        if not are_alike or speed is None or set(self.named_axes) & set(other.named_axes):
            return None
        return self.model_copy(update={"to": self.to | other.to, "by": self.by | other.by, "speed": speed})

    def describe_relative(self, number: int, axes: str) -> str:
        if not self.by:
            return (
                f"step {number} depends on where {axes} stand: virtual axes that it does not name stay where they are"
            )
        return f"step {number} moves {axes} by a distance, from the current position"

    @property
    def trigger_outputs(self) -> list[str]:
        return [trigger.output for trigger in self.triggers]

    def find_armed_obstacle(self) -> str:
        if self.start in ("line", "at_once"):
            return f"`start: {self.start}` has no instant that can be agreed on a request; use `start: auto`"
        return describe_armed_obstacle(aligns=bool(self.align), records=self.record is not None)

    @property
    def start_wish(self) -> StartWish:
        """The start class that it asks for."""
        return "auto" if self.start in ("agreed", "at_once") else self.start

    @property
    def wants_start_at_once(self) -> bool:
        """Whether it must start as soon as its controller can."""
        return self.start == "at_once"

    @property
    def agrees_start(self) -> bool:
        """Whether its start needs an agreement, also of one controller."""
        return self.start not in ("auto", "at_once")

    @property
    def is_synchronised(self) -> bool:
        """Whether all axes take one duration."""
        return self.sync != "none"

    @property
    def measured_targets(self) -> Mapping[str, MeasuredTarget]:
        return self.measured

    def with_measured(self, targets: Mapping[str, Quantity]) -> Self:
        return self.model_copy(update={"to": {**self.to, **targets}, "measured": {}})

    def iterate_targets(self) -> Iterator[tuple[str, Target]]:
        yield from self.to.items()

    def resolve_targets(self, resolver: TargetResolver) -> Self:
        common_target = self.to.get(ALL_AXES)
        targets: dict[str, Quantity] = {} if common_target is None else dict(resolver.find_whole(str(common_target)))
        for axis, target in self.to.items():
            if axis != ALL_AXES:
                targets[axis] = resolver.find_target(axis, target)
        targets_twice = sorted(targets.keys() & self.by.keys())
        if targets_twice:
            text = f"{', '.join(targets_twice)} is in `by` and in position {common_target}; an axis has one target"
            raise Refusal("bad-step", text, NAME_AXES)
        return self.model_copy(update={"to": targets})

    def complete_words(self, fields: list[str]) -> list[str]:
        target_words = [f"to {axis}={target.describe()}" for axis, target in self.measured.items()]
        return [*target_words, *fields, *map(describe_trigger, self.triggers)]
