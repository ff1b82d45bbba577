"""Virtual axes: coordinates that people think in, each group of which stands for as many real axes by an exact map."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Literal, Protocol, Self

from pydantic import Field, field_validator, model_validator

from orchestrator.model.axis_units import SoftLimits
from orchestrator.model.base import Id, Model, Rational
from orchestrator.model.errors import TuttiError
from orchestrator.model.names import split_name
from orchestrator.model.problems import Problem
from orchestrator.model.text.text_fields import PLAIN_TEXT
from orchestrator.model.units import Quantity, Unit, UnitError, convert_units, find_dimension, parse_quantity

MAX_AXES, MAX_GROUPS = 8, 200  # axes in one group
FORMS: dict[str, tuple[str, ...]] = {
    "slit": ("gap", "centre"),
    "jacks": ("height", "pitch", "roll"),
    "rotation": ("u", "v"),
}
"""The virtual axes of each named form, in order."""


class VirtualAxis(Model):
    """One virtual axis of a group."""

    unit: Unit
    description: Annotated[str, PLAIN_TEXT] = Field(default="", max_length=200, description="What the axis is.")
    soft_limits: SoftLimits | None = Field(default=None, description="Of its own, besides those of its real axes.")

    @field_validator("unit")
    @classmethod
    def _check_unit(cls, unit: Unit) -> Unit:
        if unit is Unit.COUNTS:
            raise ValueError("a virtual axis has no counts; give it a unit of length or of angle")
        return unit

    @model_validator(mode="after")
    def _check_soft_limits(self) -> Self:
        if self.soft_limits is not None:
            low, high = (parse_quantity(end, self.unit) for end in (self.soft_limits.min, self.soft_limits.max))
            if low >= high:
                raise ValueError(
                    f"soft_limits.min ({self.soft_limits.min}) is not below max ({self.soft_limits.max}); swap them"
                )
        return self


class VirtualGroup(Model):
    """Virtual axes that stand for as many real ones: `linear` by a matrix, or one of the named forms.

    Positions are user positions. With M of `matrix`, in the units of the axes: virtual = M x real + offset.

    `slit`: two blades, each counted in the positive direction: gap = first - second, centre = their mean.
    `jacks`: three jacks under a table, at `places`: height is that of the table's origin, pitch and roll are the slopes
    of its plane along y and along x, as angles of small size (mrad: mm per m).
    `rotation`: two axes at a right angle, seen in a frame turned by `angle`: u = cos x first + sin x second.
    """

    kind: Literal["linear", "slit", "jacks", "rotation"] = Field(
        default="linear", description="How virtual positions follow from real ones."
    )
    of: list[str] = Field(min_length=1, max_length=MAX_AXES, description="The real axes `controller.axis`, in order.")
    axes: dict[Id, VirtualAxis] = Field(min_length=1, description="The virtual axes, as many as real ones.")
    matrix: dict[Id, list[Rational]] | None = Field(
        default=None,
        description="With `linear`: a row for each virtual axis, its change per unit of each real axis, exact: "
        '0.5, "1/3".',
    )
    offset: dict[Id, Quantity] = Field(
        default={}, description="Virtual positions where all real axes are at 0; 0 without it."
    )
    places: list[Annotated[list[Quantity], Field(min_length=2, max_length=2)]] | None = Field(
        default=None, description="With `jacks`: where each of them stands, [x, y] in mm, from the table's origin."
    )
    angle: float | None = Field(
        default=None, description="With `rotation`: degrees, from the first axis towards the second."
    )

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        repetitions = [name for name in self.of if self.of.count(name) > 1]
        if repetitions:
            raise ValueError(f"{repetitions[0]} is in `of` twice; name each real axis once")
        names = FORMS.get(self.kind, tuple(self.axes))
        if set(self.axes) != set(names):
            raise ValueError(f"`kind: {self.kind}` has the axes {', '.join(names)}; `axes` has {', '.join(self.axes)}")
        if len(names) != len(self.of):
            raise ValueError(
                f"{len(names)} virtual axes of {len(self.of)} real ones: a position of one must belong to exactly one "
                "of the other; name as many of both"
            )
        return self

    @model_validator(mode="after")
    def _check_fields_of_kind(self) -> Self:
        for field, kind in (("matrix", "linear"), ("places", "jacks"), ("angle", "rotation")):
            if (getattr(self, field) is not None) != (self.kind == kind):
                verb = "needs" if self.kind == kind else "has no"
                raise ValueError(f"`kind: {self.kind}` {verb} `{field}`")
        for field in ("matrix", "offset"):
            strangers = [name for name in getattr(self, field) or () if name not in self.axes]
            if strangers:
                raise ValueError(f"`{field}` names {strangers[0]}, which is none of its axes: {', '.join(self.axes)}")
        return self

    @model_validator(mode="after")
    def _check_matrix(self) -> Self:
        if self.matrix is None:
            return self
        for name in self.axes:
            if name not in self.matrix:
                raise ValueError(f"`matrix` has no row for {name}")
            if len(self.matrix[name]) != len(self.of):
                raise ValueError(f"matrix.{name} has {len(self.matrix[name])} numbers for {len(self.of)} real axes")
        return self

    @model_validator(mode="after")
    def _check_quantities(self) -> Self:
        if self.places is not None and len(self.places) != len(self.of):
            raise ValueError(f"`places` has {len(self.places)} entries for {len(self.of)} jacks; give one for each")
        for name, value in self.offset.items():
            parse_quantity(value, self.axes[name].unit, name)
        for end in (end for corner in self.places or () for end in corner):
            parse_quantity(end, Unit.MM, "a place")
        return self


# Maps

Matrix = tuple[tuple[Fraction, ...], ...]

WORST_CONDITION = 1e6
"""A group that maps a small cube to a body so much longer than wide has lost an axis in practice (as frames)."""


@dataclass(frozen=True, slots=True)
class LinearMap:
    """virtual = matrix x real + offset, in the units of the axes, with rationals: nothing is rounded.

    real, virtual: names of axes in order. inverse: of the matrix.
    """

    real: tuple[str, ...]
    virtual: tuple[str, ...]
    matrix: Matrix
    inverse: Matrix
    offset: tuple[Fraction, ...]

    def to_virtual(self, positions: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Virtual positions of real ones, in order."""
        return tuple(part + offset for part, offset in zip(_multiply(self.matrix, positions), self.offset, strict=True))

    def to_real(self, positions: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Real positions of virtual ones, in order."""
        distances = [position - offset for position, offset in zip(positions, self.offset, strict=True)]
        return _multiply(self.inverse, distances)


class SingularMap(TuttiError, ValueError):
    """A matrix that has no useful inverse."""


def make_map(name: str, group: VirtualGroup, units: Mapping[str, Unit]) -> LinearMap:
    """The map of group `name`. units: of its real axes. Raises `SingularMap`, `UnitError`."""
    order = FORMS.get(group.kind, tuple(group.axes))
    real_units = [units[axis] for axis in group.of]
    virtual_units = [group.axes[axis].unit for axis in order]
    if group.matrix is not None:
        matrix: Matrix = tuple(tuple(group.matrix[axis]) for axis in order)
    else:
        forward = _FORMS[group.kind](group)
        # The forms are in mm and rad.
        matrix = tuple(
            tuple(factor * _base(unit) / _base(virtual_unit) for factor, unit in zip(row, real_units, strict=True))
            for row, virtual_unit in zip(forward, virtual_units, strict=True)
        )
        _check_dimensions(group, order, units)
    condition = find_condition(matrix)
    if not condition < WORST_CONDITION:
        raise SingularMap(
            f"different positions of its real axes give the same virtual ones (condition {condition:.3g}, at most "
            f"{WORST_CONDITION:g}); correct the {'matrix' if group.matrix is not None else 'places'}"
        )
    offsets = [parse_quantity(group.offset.get(axis, 0), group.axes[axis].unit) for axis in order]
    virtual = tuple(f"{name}.{axis}" for axis in order)
    return LinearMap(tuple(group.of), virtual, matrix, invert(matrix), tuple(offsets))


def find_condition(matrix: Matrix) -> float:
    """The condition number with rows and columns of one size, so that units do not count; infinite if singular."""
    import numpy as np

    table = np.array([[float(factor) for factor in row] for row in matrix])
    for axis in (1, 0):
        size = np.abs(table).max(axis=axis, keepdims=True)
        if not size.all():
            return math.inf
        table = table / size
    return float(np.linalg.cond(table))


def invert(matrix: Matrix) -> Matrix:
    """The exact inverse, by Gauss and Jordan. Raises `SingularMap`."""
    size = len(matrix)
    rows = [[*row, *(Fraction(int(i == j)) for j in range(size))] for i, row in enumerate(matrix)]
    for column in range(size):
        pivot = next((i for i in range(column, size) if rows[i][column]), None)
        if pivot is None:
            raise SingularMap("its matrix has no inverse")
        rows[column], rows[pivot] = rows[pivot], rows[column]
        factor = rows[column][column]
        rows[column] = [value / factor for value in rows[column]]
        for i in range(size):
            if i != column and (factor := rows[i][column]):
                rows[i] = [value - factor * top for value, top in zip(rows[i], rows[column], strict=True)]
    return tuple(tuple(row[size:]) for row in rows)


def _multiply(matrix: Matrix, values: Sequence[Fraction]) -> tuple[Fraction, ...]:
    return tuple(
        sum((factor * value for factor, value in zip(row, values, strict=True)), Fraction(0)) for row in matrix
    )


def _base(unit: Unit) -> Fraction:
    """The size of a unit in mm or rad."""
    base = Unit.MM if find_dimension(unit) == "length" else Unit.RAD
    return convert_units(Fraction(1), unit, base)


def _check_dimensions(group: VirtualGroup, order: Sequence[str], units: Mapping[str, Unit]) -> None:
    """The named forms are of lengths, but for the slopes of a table."""
    for axis in group.of:
        convert_units(Fraction(1), units[axis], Unit.MM, axis)
    for axis in order:
        base = Unit.RAD if axis in ("pitch", "roll") else Unit.MM
        convert_units(Fraction(1), group.axes[axis].unit, base, axis)


def _make_slit(group: VirtualGroup) -> Matrix:
    del group
    half = Fraction(1, 2)
    return (Fraction(1), Fraction(-1)), (half, half)


def _make_jacks(group: VirtualGroup) -> Matrix:
    """The height of each jack is height + pitch x y + roll x x, in mm and rad."""
    places = [[parse_quantity(end, Unit.MM) for end in corner] for corner in group.places or ()]
    heights: Matrix = tuple((Fraction(1), y, x) for x, y in places)
    if not find_condition(heights) < WORST_CONDITION:
        raise SingularMap("its jacks stand on one line, so a table on them can turn over; correct the places")
    return invert(heights)


def _make_rotation(group: VirtualGroup) -> Matrix:
    angle = math.radians(group.angle or 0.0)
    # Rounded once; the inverse is exact from then on.
    cosine, sine = (Fraction(f"{value:.15f}") for value in (math.cos(angle), math.sin(angle)))
    return (cosine, sine), (-sine, cosine)


_FORMS = {"slit": _make_slit, "jacks": _make_jacks, "rotation": _make_rotation}


# All of a fleet


class RealAxis(Protocol):
    """What a map needs to know of a real axis."""

    @property
    def unit(self) -> Unit: ...

    @property
    def wrap(self) -> Quantity | None: ...


class VirtualAxes:
    """All virtual axes of a fleet. maps: by group."""

    def __init__(self, groups: Mapping[str, VirtualGroup], find_axis: Callable[[str], RealAxis]) -> None:
        """groups: valid ones. find_axis: the real axis of a name."""
        self._groups = groups
        self.maps: dict[str, LinearMap] = {
            name: make_map(name, group, {axis: find_axis(axis).unit for axis in group.of})
            for name, group in groups.items()
        }

    def find(self, name: str) -> VirtualAxis:
        """The virtual axis `group.axis`, which exists."""
        group, axis = split_name(name)
        return self._groups[group].axes[axis]

    def unit_of(self, name: str) -> Unit:
        """The unit of a virtual axis."""
        return self.find(name).unit

    def explain_beyond_limits(self, name: str, position: Fraction) -> str | None:
        """Why a position is outside the soft limits of a virtual axis itself; None if it is inside."""
        axis = self.find(name)
        if axis.soft_limits is None:
            return None
        low, high = (parse_quantity(end, axis.unit) for end in (axis.soft_limits.min, axis.soft_limits.max))
        if low <= position <= high:
            return None
        return (
            f"axis {name}: target {float(position):g} {axis.unit} is beyond its soft limits {float(low):g} to "
            f"{float(high):g} {axis.unit}"
        )

    def explain_target(self, name: str, value: Quantity) -> str | None:
        """Why a value of a file cannot be a position of a virtual axis; None if it can."""
        try:
            return self.explain_beyond_limits(name, parse_quantity(value, self.unit_of(name)))
        except UnitError as error:
            return str(error)


def find_virtual_problems(groups: Mapping[str, VirtualGroup], find_axis: Callable[[str], RealAxis]) -> list[Problem]:
    """What is wrong with virtual axes beside their names. find_axis: raises `ValueError` for an unknown name."""
    return [problem for name, group in groups.items() for problem in _find_problems(name, group, find_axis)]


def _find_problems(name: str, group: VirtualGroup, find_axis: Callable[[str], RealAxis]) -> Iterator[Problem]:
    axes: dict[str, RealAxis] = {}
    for number, axis in enumerate(group.of):
        try:
            axes[axis] = find_axis(axis)
        except ValueError:
            return  # reported with the other names
        if axes[axis].wrap is not None:
            text = f"axis {axis} wraps, so its position is not unique; virtual axes need axes that do not wrap"
            yield Problem(("virtual", name, "of", number), text, axis)
    try:
        make_map(name, group, {axis: config.unit for axis, config in axes.items()})
    except (SingularMap, UnitError) as error:
        yield Problem(("virtual", name), str(error))
