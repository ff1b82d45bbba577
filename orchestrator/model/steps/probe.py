"""Axes move until an input changes, or to a position."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, get_args

from pydantic import Field, model_validator

from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import AxisTargets, Target, controller_of
from orchestrator.model.steps.base import Step, TargetResolver
from orchestrator.model.steps.measured import MEASURED, MeasuredTarget, name_contacts, split_measured
from orchestrator.model.steps.speed import MANUAL, Speed, scale_speed
from orchestrator.model.units import AxisQuantity, Quantity

Direction = Literal["forward", "reverse"]
"""Of a limit switch, in the direction of the controller's counts."""


def find_line_ramps(axes: Mapping[str, Axis], speeds: Mapping[str, float]) -> dict[str, float]:
    """The ramps of axes that come to these speeds together, in their units/s²: each within its acceleration. speeds: in
    their units/s; the ramp of an axis that stands is its acceleration."""
    ramp_s = max(speeds[name] / axis.limits.acceleration for name, axis in axes.items())
    return {name: speeds[name] / ramp_s if speeds[name] else axis.limits.acceleration for name, axis in axes.items()}


class Probe(Step):
    """Move axes on a straight line until an input changes, or to a position where they come to rest without that.
    The report has their positions at which the input changed, as intervals."""

    moves: ClassVar[bool] = True
    is_swept: ClassVar[bool] = True
    probes: ClassVar[bool] = True
    UNSAID: ClassVar[frozenset[str]] = frozenset({"measured"})

    do: Literal["probe"] = "probe"
    to: AxisTargets = Field(
        default={},
        description="The axis and where it goes at most: a quantity, or the name of a position. Several axes move on "
        "a straight line: those of one controller, where it can stop them on that; others with `by: host`.",
    )
    measured: dict[str, MeasuredTarget] = MEASURED
    start: dict[str, AxisQuantity] = Field(
        default={}, description="Where axes must stand before, within a count; nothing moves otherwise."
    )
    until: str = Field(
        description="controller.input, of the same controller as the axes, with `by: host` of any one; or "
        "controller.axis.forward or controller.axis.reverse: its own limit switch, as the state names it."
    )
    level: Literal["active", "passive"] = Field(
        default="active", description="What the input becomes; it must be the other one at the beginning."
    )
    speed: Speed = Field(
        description='How fast it moves: "1 mm/s", of several axes with one unit along their line; a fraction of the '
        "velocity limits; one of both by axis ({gantry.x: 1 mm/s}), the others at most at their limits; or `manual`: "
        "`manual_speed` of each axis. The slowest axis of a line sets its speed."
    )
    otherwise: Literal["fail", "continue"] = Field(
        default="fail", alias="else", description="What to do if the input has not changed up to there."
    )
    by: Literal["controller", "host"] = Field(
        default="controller",
        description="What stops the axes: their controller; or, later by far, the computer that polls the input. "
        "Several axes, and those of another controller than the input, the coordinator stops then.",
    )

    if TYPE_CHECKING:

        def __init__(
            self,
            *,
            to: Mapping[str, Any],
            until: str,
            speed: float | str | Mapping[str, float | str],
            name: str | None = None,
            **more: Any,
        ) -> None: ...

    @model_validator(mode="before")
    @classmethod
    def _split_measured(cls, fields: Any) -> Any:
        return split_measured(fields, "to")

    @model_validator(mode="after")
    def _stoppable(self) -> "Probe":
        if not self.axes:
            raise ValueError("`to` names no axis; write e.g. `to: {gantry.x: 15}`")
        first, is_line = self.axes[0], self.is_line
        for axis in self.axes:
            if self.by != "host" and controller_of(axis) != controller_of(self.until):
                text = f"{self.until} cannot stop {axis}, which is of another controller"
                raise ValueError(f"{text}: let the coordinator stop it, which is later (`by: host`)")
        if self.until.count(".") > 1 and self.limit is None:
            if is_line:
                raise ValueError(f"{self.until} ends no line: a limit switch stops its own axis; probe with that alone")
            raise ValueError(f"{self.until} is no limit switch of {first}: {first}.forward or .reverse")
        if self.limit is not None and (self.level, self.by) != ("active", "controller"):
            raise ValueError(f"a limit switch stops {first} by its controller, when it becomes active")
        if isinstance(self.speed, dict) and (strangers := self.speed.keys() - set(self.axes)):
            raise ValueError(f"speed names {', '.join(sorted(strangers))}, which the probe does not move")
        return self

    @property
    def axes(self) -> list[str]:
        """The axes that it moves."""
        return [*self.to, *self.measured]

    @property
    def is_line(self) -> bool:
        """Whether it moves several axes on a line."""
        return len(self.axes) > 1

    @property
    def is_held(self) -> bool:
        """Whether the coordinator stops it, by the states of the controller of the input."""
        is_other = controller_of(self.until) != controller_of(self.axes[0])
        return self.by == "host" and (self.is_line or is_other)

    @property
    def limit(self) -> Direction | None:
        """The limit switch that ends it; None: an input does."""
        if self.is_line:
            return None
        return next((way for way in get_args(Direction) if self.until == f"{self.axes[0]}.{way}"), None)

    @property
    def named_axes(self) -> list[str]:
        return self.axes

    @property
    def absolute_axes(self) -> list[str]:
        return self.axes

    @property
    def placed_axes(self) -> list[str]:
        return self.axes

    @property
    def awaited_inputs(self) -> list[str]:
        return [] if self.limit is not None else [self.until]

    @property
    def relative_axes(self) -> list[str]:
        # The direction, and the bounds of what it finds.
        return self.axes

    def describe_relative(self, number: int, axes: str) -> str:
        return f"step {number} probes with {axes} from the current position"

    def slow_down(self, rate: float, fleet: Fleet) -> Self:
        speed = self.speed
        if speed == MANUAL:
            speed = {axis: fleet.axis(axis).manual_speed for axis in self.axes}
        return self.model_copy(update={"speed": scale_speed(speed, rate)})

    @property
    def measured_targets(self) -> Mapping[str, MeasuredTarget]:
        return self.measured

    def with_measured(self, targets: Mapping[str, Quantity]) -> Self:
        return self.model_copy(update={"to": {**self.to, **targets}, "measured": {}})

    @property
    def contact_names(self) -> Mapping[str, str]:
        return name_contacts(self.name, self.axes)

    def iterate_targets(self) -> Iterator[tuple[str, Target]]:
        yield from self.to.items()

    def resolve_targets(self, resolver: TargetResolver) -> Self:
        return self.model_copy(
            update={"to": {axis: resolver.find_target(axis, target) for axis, target in self.to.items()}}
        )

    def complete_words(self, fields: list[str]) -> list[str]:
        return [*(f"to {axis}={target.describe()}" for axis, target in self.measured.items()), *fields]
