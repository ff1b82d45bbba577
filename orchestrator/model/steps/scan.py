"""A scan: axes move from point to point, and steps run at each."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import Target
from orchestrator.model.steps.armed_terms import describe_armed_obstacle
from orchestrator.model.steps.base import InnerSteps, MotionOptions, Step, TargetResolver
from orchestrator.model.steps.dwell import Dwell
from orchestrator.model.steps.fly import FlyOptions
from orchestrator.model.steps.io import SetOutput, WaitInput
from orchestrator.model.steps.move import NAME_AXES, Move
from orchestrator.model.steps.points import MAX_POINTS, MAX_SCAN_AXES, GridPoints, PointTable, ScanAxis, ScanSpec
from orchestrator.model.steps.triggers import MAX_PLACES
from orchestrator.model.units import Quantity

MAX_AT_EACH = 50  # steps at each point of a scan

PointStep = Annotated[Move | Dwell | SetOutput | WaitInput, Field(discriminator="do")]

_NOT_AT_EACH = {
    "home": "it would take the reference away between two points; put it before the scan",
    "enable": "axes are switched before the scan; put it there",
    "disable": "the next point needs the axes; put it behind the scan",
    "path": "a scan stops at its points; put the path before or behind the scan",
    "latch": "the record of a scan has no place for it; put it before or behind the scan",
    "probe": "the record of a scan has no place for it; put it before or behind the scan",
    "set-position": "it would shift the points after it; put it before the scan",
    "save-position": "it would be saved anew at each point; put it before or behind the scan",
    "scan": "add its axes to `axes` of this scan instead",
    "repeat": "write its steps out, or repeat the scan",
}


class ScanPoints(Step):
    """Where a scan goes, and what it does there."""

    UNSAID: ClassVar[frozenset[str]] = frozenset({"axes", "points", "scanspec", "at_each", "fly"})

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
    fly: FlyOptions | None = Field(
        default=None,
        description="The last of `axes`, or the last ones together, pass their points at constant speed, instead of a "
        "stop at each.",
    )


class Scan(MotionOptions, ScanPoints):
    """Move axes from point to point, and stop at each, or fly through them line by line. Positions are absolute."""

    if TYPE_CHECKING:

        def __init__(
            self,
            *,
            axes: Mapping[str, Mapping[str, Any] | ScanAxis] = ...,
            points: Mapping[str, Any] | PointTable | None = None,
            scanspec: Mapping[str, Any] | None = None,
            at_each: Sequence["Move | Dwell | SetOutput | WaitInput"] = (),
            fly: Mapping[str, Any] | FlyOptions | None = None,
            **more: Any,
        ) -> None: ...

    @field_validator("at_each", mode="before")
    @classmethod
    def _allowed_at_points(cls, value: Any) -> Any:
        steps: list[Any] = list(value) if isinstance(value, list | tuple) else []  # pyright: ignore[reportUnknownArgumentType]
        for number, step in enumerate(steps):
            kind = str(step.get("do") if isinstance(step, dict) else getattr(step, "do", ""))  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]
            if kind in _NOT_AT_EACH:
                raise ValueError(f"at_each[{number}]: `do: {kind}` cannot stand in `at_each`: {_NOT_AT_EACH[kind]}")
        return value  # pyright: ignore[reportUnknownVariableType]

    @model_validator(mode="after")
    def _one_source(self) -> "Scan":
        if sum(bool(axis) for axis in (self.axes, self.points, self.scanspec)) != 1:
            raise ValueError("a scan needs one of `axes`, `points` and `scanspec`")
        for number, repetitions in find_moved_twice(self.axis_names, self.at_each):
            raise ValueError(
                f"at_each[{number}] moves {', '.join(repetitions)}, which the scan positions; move other axes there"
            )
        if self.fly is not None:
            self._check_line(self.fly.axis)
        self._check_curve()
        if self.point_count > MAX_POINTS:
            raise ValueError(f"has {self.point_count} points; the maximum is {MAX_POINTS}")
        if self.fly is not None:
            self._check_flown(self.fly)
        return self

    def _check_line(self, names: Sequence[str] | None) -> None:
        """Raise `ValueError` for axes that are named to fly together, and cannot be on one line. names: of them."""
        if names is None or not self.axes:
            return
        last_names = list(self.axes)[-len(names) :]
        if sorted(names) != sorted(last_names):
            raise ValueError(
                f"`fly.axis` has {', '.join(names)}, and the last of `axes` are {', '.join(last_names)}; those that "
                "fly together must be the last ones, each once"
            )
        counts = {name: self.axes[name].count for name in last_names}
        if len(set(counts.values())) > 1:
            words = ", ".join(f"{name} has {count}" for name, count in counts.items())
            raise ValueError(f"`fly.axis`: axes on one line need as many points each; {words}")
        if len({self.axes[name].snake for name in last_names}) > 1:
            raise ValueError(f"`fly.axis`: write the same `snake` for {', '.join(last_names)}, which are on one line")

    def _check_curve(self) -> None:
        """Raise `ValueError` for bounds of windows of axes that are not flown along a curve."""
        curved_names = [name for name, axis in self.axes.items() if axis.bounds is not None]
        if not curved_names:
            return
        if self.fly is None or set(curved_names) != set(self.flown_axes):
            raise ValueError(
                f"`bounds` are for all axes that fly along a curve; {', '.join(curved_names)} have them, "
                f"and {', '.join(self.flown_axes) if self.fly is not None else 'no axes'} fly"
            )
        if self.fly.wait is not None:
            raise ValueError("`fly.wait` is for straight lines; put a step `do: wait` before a scan along a curve")
        if self.fly.speed is not None:
            raise ValueError("`fly.speed`: windows on a curve have several lengths, and one time; write `duration`")

    def _check_flown(self, fly: FlyOptions) -> None:
        """Raise `ValueError` for a scan that cannot be flown, whatever its axes are."""
        if not self.axes and self.scanspec is None:
            raise ValueError("`fly` needs the lines of `axes`, or of a `scanspec` with `Fly`; a table has none")
        if self.at_each:
            raise ValueError("a scan that flies does not stop, so nothing runs in `at_each`; remove one of them")
        if not self.axes:
            return  # checked once the spec is read
        name, count = self.flown_axis, self.line_points
        if count < 2:
            raise ValueError(f"`fly`: {name} has one point, and a line needs two at least; leave out `fly`")
        if fly.trigger is not None and count > MAX_PLACES:
            raise ValueError(
                f"`fly`: a line has {count} points, and a trigger at most {MAX_PLACES} places; use shorter lines"
            )

    @property
    def flown_axes(self) -> list[str]:
        """The axes that fly, together along each line: the innermost one, or those that `fly` names. Only of a scan
        with `axes`."""
        joint = 1 if self.fly is None or self.fly.axis is None else len(self.fly.axis)
        return list(self.axes)[-joint:]

    @property
    def flown_axis(self) -> str:
        """The last one of them."""
        return self.flown_axes[-1]

    @property
    def is_curved(self) -> bool:
        """Whether it flies along curves."""
        return bool(self.axes) and self.axes[self.flown_axis].bounds is not None

    @property
    def grid(self) -> GridPoints:
        """The points of `axes`. Only of a scan with them."""
        return GridPoints(self.axes, len(self.flown_axes))

    @property
    def line_points(self) -> int:
        """The points of one line: the positions of the innermost axis. Only of a scan with `axes`."""
        return self.axes[self.flown_axis].count

    @property
    def points_together(self) -> int:
        """How many points the steps of `points_steps` are for: a line that is flown has all its points."""
        return 1 if self.fly is None else self.line_points

    @property
    def axis_names(self) -> list[str]:
        """The axes that it positions; none while they are in a file that was not read yet."""
        return list(self.axes) or ([] if self.points is None else self.points.axis_names)

    @property
    def point_count(self) -> int:
        """The number of points; 0 while they are in a file that was not read yet."""
        if self.axes:
            return self.grid.count
        return 0 if self.points is None else self.points.point_count

    def make_move(self, positions: Mapping[str, float]) -> Move:
        """The move to one point."""
        options = {name: getattr(self, name) for name in ("name", *MotionOptions.model_fields)}
        # Everything in it was validated with the scan.
        return Move.model_construct(to=dict(positions), **options)

    @property
    def points_steps(self) -> int:
        """The number of steps at one point, its move included; of a line that is flown its move, its path, and the
        input that is waited for in between."""
        if self.fly is None:
            return 1 + len(self.at_each)
        return 2 if self.fly.wait is None else 3

    @property
    def inner(self) -> InnerSteps:
        return InnerSteps("at_each", self.at_each, self.point_count, "at point")

    @property
    def step_count(self) -> int:
        return self.point_count // self.points_together * self.points_steps

    @property
    def can_wait_armed(self) -> bool:
        """The flight of its first line, or lines, may; a spec says itself whether it flies."""
        return self.fly is not None or self.scanspec is not None

    def find_armed_obstacle(self) -> str:
        if self.fly is not None and self.fly.wait is not None:
            return "`fly.wait` has each of its lines wait for an input; remove one of both"
        return describe_armed_obstacle(aligns=bool(self.align), records=False)

    @property
    def trigger_outputs(self) -> list[str]:
        return [] if self.fly is None or self.fly.trigger is None else [self.fly.trigger.output]

    def iterate_written(self) -> Iterator[Step]:
        yield self
        yield from self.at_each
        if self.fly is not None and self.fly.wait is not None:
            yield self.fly.wait

    @property
    def named_axes(self) -> list[str]:
        return self.axis_names

    def find_axes(self, fleet: Fleet) -> list[str]:
        return fleet.find_real_axes(self.axis_names)

    @property
    def absolute_axes(self) -> list[str]:
        return self.axis_names

    @property
    def placed_axes(self) -> list[str]:
        return self.axis_names

    @property
    def has_unread_points(self) -> bool:
        return self.scanspec is not None or (self.points is not None and bool(self.points.file))

    def iterate_targets(self) -> Iterator[tuple[str, Target]]:
        for name, axis in self.axes.items():
            ends = [end for end in (axis.from_, axis.to) if end is not None]
            yield from ((name, value) for value in axis.values or ends)
        if self.points is not None:
            for row in self.points.rows or []:
                yield from zip(self.points.axis_names, row, strict=True)

    def resolve_targets(self, resolver: TargetResolver) -> Self:
        at_each = [resolver.resolve_step(step) for step in self.at_each]
        # A position may have axes that the file does not name.
        for number, repetitions in find_moved_twice(self.axis_names, at_each):
            text = f"at_each[{number}] moves {', '.join(repetitions)} by a position, and the scan positions it"
            raise Refusal("bad-step", text, NAME_AXES)
        return self.replace_targets(resolver.find_target).model_copy(update={"at_each": at_each})

    def replace_targets(self, find_target: Callable[[str, Target], Quantity]) -> Self:
        """The scan with other positions. find_target: makes one, of an axis and what is written for it."""

        def find_listed(name: str, targets: Sequence[Target] | None) -> list[Quantity] | None:
            return None if targets is None else [find_target(name, target) for target in targets]

        axes: dict[str, ScanAxis] = {}
        for name, axis in self.axes.items():
            ends = {"from_": axis.from_, "to": axis.to}
            found_targets = {end: None if target is None else find_target(name, target) for end, target in ends.items()}
            axes[name] = axis.model_copy(update={**found_targets, "values": find_listed(name, axis.values)})
        table = self.points
        if table is not None and table.rows is not None:
            names = table.axis_names
            rows = [[find_target(*pair) for pair in zip(names, row, strict=True)] for row in table.rows]
            table = table.model_copy(update={"rows": rows})
        return self.model_copy(update={"axes": axes, "points": table})

    def complete_words(self, fields: list[str]) -> list[str]:
        at_each = ["at each " + "; ".join(step.describe() for step in self.at_each)] if self.at_each else []
        flown_words = [] if self.fly is None else [self.fly.describe("a curve" if self.is_curved else "one line")]
        return [self._describe_points(), *flown_words, *fields, *at_each]

    def _describe_points(self) -> str:
        if self.points is not None and self.points.file is not None:
            return f"points of {self.points.file}"
        axes = " ".join(f"{name}={_describe_axis(axis)}" for name, axis in self.axes.items())
        axes = axes or " ".join(self.axis_names)
        return f"{axes}, {self.point_count} points" if axes else "points of a scanspec"


def _describe_axis(axis: ScanAxis) -> str:
    snake = " snake" if axis.snake else ""
    if axis.values is not None:
        return f"{len(axis.values)} values{snake}"
    return f"{axis.from_}…{axis.to} ({axis.count}{snake})"


def find_moved_twice(axes: Iterable[str], at_each: Iterable[Step]) -> Iterator[tuple[int, list[str]]]:
    """The steps at the points of a scan that move what the scan positions: the number of each, and those axes. axes: of
    the scan."""
    scanned_axes = set(axes)
    for number, step in enumerate(at_each):
        axes_twice = sorted(scanned_axes & set(step.named_axes))
        if axes_twice:
            yield number, axes_twice
