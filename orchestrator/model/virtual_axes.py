"""Virtual axes in a fleet file: coordinates that people think in, each group of which stands for as many real axes."""

import hashlib
import json
from collections.abc import Mapping
from fractions import Fraction
from typing import Annotated, Any, Literal, Self, TypeGuard, cast

from pydantic import Field, ModelWrapValidatorHandler, field_validator, model_validator

from orchestrator.model.axis_units import SoftLimits, convert_rates
from orchestrator.model.base import Id, Model, Rational
from orchestrator.model.compensation import CrossTable
from orchestrator.model.names import split_name
from orchestrator.model.numbers import UnitNumber
from orchestrator.model.problems import validate_with
from orchestrator.model.text.text_fields import PLAIN_TEXT
from orchestrator.model.units import Quantity, Unit, parse_quantity

MAX_AXES, MAX_GROUPS = 8, 200  # axes in one group
MAX_TABLES = 16  # of one group
MOST_LEAN = Fraction(1, 100)
"""Rad. More than that is an error of the unit, or a frame with `skew`."""
FORMS: dict[str, tuple[str, ...]] = {
    "slit": ("gap", "centre"),
    "jacks": ("height", "pitch", "roll"),
    "rotation": ("u", "v"),
    "sine_bar": ("angle",),
    "energy": ("energy", "exit"),
}
"""The virtual axes of each named form, in order. `energy` may be without the last one; those of `pair` are named in the
file."""
RACK = "rack"
"""The second virtual axis of a pair, unless the file names it."""
Kind = Literal["linear", "slit", "jacks", "rotation", "sine_bar", "energy", "code", "pair", "corrected"]
_FIELDS: dict[str, tuple[Kind, ...]] = {
    "matrix": ("linear",),
    "places": ("jacks",),
    "angle": ("rotation", "energy"),
    "length": ("sine_bar",),
    "spacing": ("energy",),
    "kinematics": ("code",),
    "parameters": ("code",),
    "pair": ("pair",),
    "tables": ("corrected",),
    "squareness": ("corrected",),
}
"""The kinds that have a field."""
_OPTIONAL = ("angle", "parameters", "tables", "squareness")


def list_axes(group: Any) -> list[str]:
    """The names of the axes of a group, as a file gives it, with the one that a pair need not name."""
    axes = cast(Mapping[str, Any], group).get("axes") if isinstance(group, Mapping) else None
    names = [str(name) for name in cast(Mapping[str, Any], axes)] if isinstance(axes, Mapping) else []
    return [*names, RACK] if _is_pair(group) and len(names) == 1 and names != [RACK] else names


def _is_pair(group: Any) -> TypeGuard[Mapping[str, Any]]:
    return isinstance(group, Mapping) and cast(Mapping[str, Any], group).get("pair") is not None


class VirtualJogSettings(Model):
    """How a virtual axis is jogged, and how far it may be off its position while another one of its group is."""

    speed: UnitNumber | None = Field(
        default=None, description="Maximum jog speed, unit/s; default: as its real axes allow."
    )
    deviation: UnitNumber | None = Field(
        default=None,
        description="In the axis's unit: how far it may be off its position while another axis of the group is jogged, "
        "which is limited to a speed at which it stays below.",
    )


class VirtualAxis(Model):
    """One virtual axis of a group."""

    unit: Unit
    description: Annotated[str, PLAIN_TEXT] = Field(default="", max_length=200, description="What the axis is.")
    soft_limits: SoftLimits | None = Field(default=None, description="Of its own, besides those of its real axes.")
    jog: VirtualJogSettings = VirtualJogSettings()

    @model_validator(mode="wrap")
    @classmethod
    def _convert_units(cls, data: Any, handler: ModelWrapValidatorHandler["VirtualAxis"]) -> "VirtualAxis":
        plain, problems = convert_rates(data)
        return validate_with(problems, cls.__name__, lambda: handler(plain))

    @field_validator("unit")
    @classmethod
    def _check_unit(cls, unit: Unit) -> Unit:
        if unit is Unit.COUNTS:
            raise ValueError("a virtual axis has no counts; give it a unit of length or of angle")
        return unit

    @model_validator(mode="after")
    def _check_soft_limits(self) -> Self:
        if self.soft_limits is not None:
            low, high = self.soft_limits.in_unit(self.unit)
            if low >= high:
                raise ValueError(
                    f"soft_limits.min ({self.soft_limits.min}) is not below max ({self.soft_limits.max}); swap them"
                )
        return self


class PairSettings(Model):
    """How far two axes that carry one beam may be apart, in a unit of their kind. What counts is their difference,
    first - second, less `square`."""

    max_deviation: Quantity = Field(description="Farther apart than this, both are stopped.")
    may_rack: Quantity = Field(
        description="How far apart the machine stands without damage: limits the speed, by what a fault may do."
    )
    square: Quantity = Field(default=0, description="First - second where the beam is square, by their references.")


class VirtualGroup(Model):
    """Virtual axes that stand for as many real ones: `linear` by a matrix, by one of the named forms, or by `code`.

    Positions are user positions. With M of `matrix`, in the units of the axes: virtual = M x real + offset.

    `slit`: two blades, each counted in the positive direction: gap = first - second, centre = their mean.
    `jacks`: three jacks under a table, at `places`: height is that of the table's origin, pitch and roll are the slopes
    of its plane along y and along x, as angles of small size (mrad: mm per m).
    `rotation`: two axes at a right angle, seen in a frame turned by `angle`: u = cos x first + sin x second.
    `sine_bar`: a bar of `length` that one linear axis lifts: sin angle = real / length + sin offset.
    `energy`: a crystal with planes at `spacing`, turned by the first axis: energy = hc / (2 spacing sin theta), with
    theta = real + `angle`. With a second axis, the distance of two parallel crystals: exit = 2 distance cos theta, by
    which the beam is shifted.
    `code`: by the entry point `kinematics` of an installed package, with its `parameters`.
    `corrected`: as many axes as real ones, in the same order, each that of its real axis but for its errors: `tables`
    of errors by the positions of other axes, and the `squareness` of the first two.
    `pair`: two axes that carry one beam, of which none moves alone: their middle, with a name of the file's, and `rack`
    = first - second - square, which moves only towards 0.
    """

    kind: Kind = Field(default="linear", description="How virtual positions follow from real ones.")
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
        default=None,
        description="With `rotation`: degrees, from the first axis towards the second. With `energy`: degrees of theta "
        "where its axis is at 0; 0 without it.",
    )
    length: Quantity | None = Field(default=None, description="With `sine_bar`: between its two rollers, in mm.")
    spacing: Quantity | None = Field(
        default=None, description="With `energy`: of the crystal's planes, in mm or with a unit, e.g. 0.313560 nm."
    )
    kinematics: str | None = Field(
        default=None, max_length=100, description="With `code`: the name of an entry point `tutti.kinematics`."
    )
    parameters: dict[Id, float | Annotated[str, PLAIN_TEXT]] = Field(
        default={}, max_length=100, description="With `code`: what its code is given."
    )

    pair: PairSettings | None = Field(default=None, description="With `pair`: how far both may be apart.")
    tables: dict[Id, CrossTable] = Field(
        default={},
        max_length=MAX_TABLES,
        exclude_if=lambda tables: not tables,
        description="With `corrected`: measured errors, by names of your choice.",
    )
    squareness: Quantity | None = Field(
        default=None,
        exclude_if=lambda angle: angle is None,
        description="With `corrected`: the angle by which the second axis leans towards the first from a right angle.",
    )

    @model_validator(mode="before")
    @classmethod
    def _complete_pair(cls, data: Any) -> Any:
        """`pair` says the kind, and its second axis has the unit of the first one."""
        if not _is_pair(data):
            return data
        group = {"kind": "pair", **data}
        axes, names = group.get("axes"), list_axes(data)
        if isinstance(axes, Mapping) and len(names) > len(cast(Mapping[str, Any], axes)):
            first = cast(Mapping[str, Any], axes)[names[0]]
            unit = cast(Mapping[str, Any], first).get("unit") if isinstance(first, Mapping) else None
            group["axes"] = {names[0]: first, RACK: {"unit": unit, "description": "first - second - square"}}
        return group

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        repetitions = [name for name in self.of if self.of.count(name) > 1]
        if repetitions:
            raise ValueError(f"{repetitions[0]} is in `of` twice; name each real axis once")
        names = self.order
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
        for field, kinds in _FIELDS.items():
            is_given = getattr(self, field) not in (None, {})
            if is_given and self.kind not in kinds:
                raise ValueError(f"`kind: {self.kind}` has no `{field}`")
            is_needed = self.kind in kinds and not (field in _OPTIONAL and self.kind != "rotation")
            if is_needed and not is_given:
                raise ValueError(f"`kind: {self.kind}` needs `{field}`")
        if self.offset and self.kind in ("energy", "code", "pair", "corrected"):
            raise ValueError(f"`kind: {self.kind}` has no `offset`")
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
        for field in ("length", "spacing"):
            value = getattr(self, field)
            if value is not None and not parse_quantity(value, Unit.MM, field) > 0:
                raise ValueError(f"`{field}` is {value}; it must be above 0")
        return self

    @model_validator(mode="after")
    def _check_corrected(self) -> Self:
        if self.kind != "corrected":
            return self
        if not self.tables and self.squareness is None:
            raise ValueError("`kind: corrected` needs `tables`, `squareness`, or both")
        if self.squareness is not None:
            lean = parse_quantity(self.squareness, Unit.RAD, "squareness")
            if len(self.of) < 2:
                raise ValueError("`squareness` is between the first two axes, and there is one; remove it")
            if abs(lean) > MOST_LEAN:
                raise ValueError(
                    f"squareness is {self.squareness}, at most 10 mrad; correct the unit, or use a frame with `skew`"
                )
        for name, table in self.tables.items():
            strangers = [axis for axis in (table.axis, *table.by) if axis not in self.axes]
            if strangers:
                raise ValueError(
                    f"tables.{name} names {strangers[0]}, which is none of its axes: {', '.join(self.axes)}"
                )
        return self

    @model_validator(mode="after")
    def _check_pair(self) -> Self:
        if self.pair is None:
            return self
        if len(self.of) != 2:
            raise ValueError(f"a pair has two real axes; `of` names {len(self.of)}")
        middle, rack = self.order
        unit, rack_unit = self.axes[middle].unit, self.axes[rack].unit
        if unit != rack_unit:
            raise ValueError(f"{middle} is in {unit}, and {rack} in {rack_unit}; give both one unit")
        if self.axes[rack].soft_limits is not None:
            raise ValueError(f"{rack} has no `soft_limits`: `max_deviation` limits it")
        most, may_rack, square = (
            parse_quantity(getattr(self.pair, field), unit, field) for field in PairSettings.model_fields
        )
        if not 0 < most < may_rack:
            raise ValueError(
                f"max_deviation ({self.pair.max_deviation}) must be above 0 and below may_rack ({self.pair.may_rack}): "
                "both are stopped before the beam is racked too far"
            )
        if abs(square) > most:
            raise ValueError(
                f"square ({self.pair.square}) is beyond max_deviation ({self.pair.max_deviation}): after homing the "
                "beam would be racked by it; mount the switches nearer to square"
            )
        return self

    @property
    def order(self) -> tuple[str, ...]:
        """The names of its axes, in the order of the form."""
        names = FORMS.get(self.kind, tuple(self.axes))
        return names[: len(self.of)] if self.kind == "energy" else names


def digest_corrections(groups: Mapping[str, VirtualGroup], controller: str) -> str:
    """A digest of the corrected groups with axes of a controller, as a part of its configuration; empty without any."""
    corrected_groups = [
        [group.of, list(group.axes), {key: table.to_plain() for key, table in group.tables.items()}, group.squareness]
        for group in groups.values()
        if group.kind == "corrected" and any(split_name(axis)[0] == controller for axis in group.of)
    ]
    if not corrected_groups:
        return ""
    return hashlib.sha256(json.dumps(corrected_groups, sort_keys=True).encode()).hexdigest()[:16]
