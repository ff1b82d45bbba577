"""Keep-out zones in a fleet file: bodies that ride on axes, and rules of which bodies and positions exclude each other.

Lengths are in mm and positions are motor positions, like soft limits: a user offset does not move a body.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from orchestrator.model.base import Id, Model
from orchestrator.model.numbers import Seconds
from orchestrator.model.text.text_fields import PLAIN_TEXT
from orchestrator.model.units import Quantity, Unit, parse_quantity

MAX_BODIES, MAX_RULES, MAX_CARRIERS, MAX_CORNERS = 100, 200, 8, 32
LEAST_DISTANCE = Fraction(1, 1000)
"""mm. Bodies that are to be apart by 0 are apart by this: touching could not be told from overlap."""
Vector = tuple[float, float, float]
_DIRECTIONS: dict[str, Vector] = {
    f"{sign}{name}": (factor * x, factor * y, factor * z)
    for sign, factor in (("", 1.0), ("-", -1.0))
    for name, (x, y, z) in (("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0)), ("z", (0.0, 0.0, 1.0)))
}
_RELATION = re.compile(r"\s*([a-z0-9_-]+\.[a-z0-9_-]+)\s*([<>])\s*([^<>=\s].*?)\s*")


def _check_length(value: int | float | str) -> int | float | str:
    parse_quantity(value, Unit.MM, "a length of a body")
    return value


def _check_size(value: int | float | str) -> int | float | str:
    if parse_quantity(value, Unit.MM, "a size of a body") <= 0:
        raise ValueError(f"{value} is no size; it must be above 0")
    return value


Length = Annotated[Quantity, AfterValidator(_check_length)]
"""In mm, or with a unit of length."""
Size = Annotated[Quantity, AfterValidator(_check_size)]
"""The same, above 0."""
Place = Annotated[list[Length], Field(min_length=3, max_length=3)]
Direction = Literal["x", "-x", "y", "-y", "z", "-z"] | Annotated[list[float], Field(min_length=3, max_length=3)]


def to_mm(value: int | float | str) -> float:
    """A length of a body, in mm."""
    return float(parse_quantity(value, Unit.MM))


def to_vector(place: Sequence[int | float | str]) -> Vector:
    """A place of the file, in mm."""
    x, y, z = map(to_mm, place)
    return x, y, z


def to_direction(direction: str | Sequence[float]) -> Vector:
    """A direction of the file, of length 1."""
    if isinstance(direction, str):
        return _DIRECTIONS[direction]
    x, y, z = direction
    length = math.hypot(x, y, z)
    return x / length, y / length, z / length


class CylinderSize(Model):
    """The size of a cylinder."""

    radius: Size
    height: Size


class PolygonSize(Model):
    """A convex outline that is extruded."""

    corners: list[Annotated[list[Length], Field(min_length=2, max_length=2)]] = Field(
        min_length=3,
        max_length=MAX_CORNERS,
        description="One after another, in either sense. Along z they are [x, y], along x [y, z], along y [z, x].",
    )
    height: Size

    @model_validator(mode="after")
    def _check_convex(self) -> Self:
        """Each corner turns in one sense, and all of them together once."""
        corners = [(to_mm(first), to_mm(second)) for first, second in self.corners]
        count, turns = len(corners), 0.0
        size = max(math.hypot(b[0] - a[0], b[1] - a[1]) for a in corners for b in corners)
        for number, (x, y) in enumerate(corners):
            corner_before, corner_after = corners[number - 1], corners[(number + 1) % count]
            edge, next_edge = (x - corner_before[0], y - corner_before[1]), (corner_after[0] - x, corner_after[1] - y)
            cross = edge[0] * next_edge[1] - edge[1] * next_edge[0]
            if abs(cross) <= 1e-9 * size * size:
                raise ValueError(f"corner {number + 1} is on a line with its neighbours; leave it out")
            angle = math.atan2(cross, edge[0] * next_edge[0] + edge[1] * next_edge[1])
            if turns and (turns > 0) != (angle > 0):
                raise ValueError(
                    f"the outline is not convex at corner {number + 1}, or crosses itself; divide it into convex bodies"
                )
            turns += angle
        if abs(turns) > 2 * math.pi * 1.01:
            raise ValueError("the outline goes around more than once; list the corners in their order")
        return self


class ZoneShape(Model):
    """One convex shape: a box, a cylinder, a sphere or an extruded polygon."""

    box: Annotated[list[Size], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description="Its sizes along x, y and z."
    )
    cylinder: CylinderSize | None = None
    sphere: Size | None = Field(default=None, description="Its radius.")
    polygon: PolygonSize | None = None
    direction: Literal["x", "y", "z"] = Field(
        default="z", description="Of the axis of a cylinder, and of the height of a polygon."
    )
    at: Place = Field(
        default=[0, 0, 0],
        description="Its middle, [x, y, z], with all axes that carry it at 0. Of a polygon: the origin of the corners, "
        "in the middle of the height.",
    )

    @model_validator(mode="after")
    def _check_shape(self) -> Self:
        names = [name for name in ("box", "cylinder", "sphere", "polygon") if getattr(self, name) is not None]
        if len(names) != 1:
            names_text = " and ".join(names) or "none"
            raise ValueError(f"it has {names_text}; state exactly one of box, cylinder, sphere and polygon")
        return self


class Carrier(Model):
    """What moves a body: another body, or one axis, which moves it along a direction or turns it about one."""

    body: Id | None = Field(default=None, description="A body on which it rides; only the first of a list can be one.")
    axis: str | None = Field(default=None, description="`controller.axis`, or a linear virtual axis `group.axis`.")
    along: Direction | None = Field(
        default=None, description="Of an axis of length: where a positive motion leads; x, -y, or [x, y, z]."
    )
    about: Direction | None = Field(
        default=None, description="Of an axis of angle: about what it turns, right-handed; x, -y, or [x, y, z]."
    )
    through: Place | None = Field(
        default=None,
        description="With `about`: a point of the axis of rotation, with all axes before it at 0; default: [0, 0, 0].",
    )

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        if (self.body is None) == (self.axis is None):
            raise ValueError("it needs either `body` or `axis`")
        ways = [name for name in ("along", "about") if getattr(self, name) is not None]
        if self.body is not None and (ways or self.through is not None):
            raise ValueError(f"it rides on the body {self.body} as that moves; leave {(*ways, 'through')[0]} out")
        if self.axis is not None and len(ways) != 1:
            raise ValueError(f"{self.axis} needs either `along` or `about`")
        direction = self.about if self.along is None else self.along
        if isinstance(direction, list) and not math.hypot(*direction) > 1e-9:
            raise ValueError(f"{direction} is no direction; at least one of the three must not be 0")
        if self.along is not None and self.through is not None:
            raise ValueError("`along` has no `through`; leave it out")
        return self


class ZoneBody(ZoneShape):
    """A body of the machine or of what stands around it."""

    description: Annotated[str, PLAIN_TEXT] = Field(default="", max_length=200, description="What it is.")
    on: list[Carrier] = Field(
        default=[],
        max_length=MAX_CARRIERS,
        description="What carries it, from the machine's frame outwards; nothing: it stands still.",
    )

    @model_validator(mode="after")
    def _check_carriers(self) -> Self:
        for number, carrier in enumerate(self.on[1:], 1):
            if carrier.body is not None:
                raise ValueError(f"on[{number}] is the body {carrier.body}; only the first entry can be a body")
        return self


class ApartRule(Model):
    """Two bodies that are never nearer to each other than a distance."""

    bodies: list[Id] = Field(min_length=2, max_length=2)
    distance: Length = Field(default=0, description="0: they do not touch.")

    @model_validator(mode="after")
    def _check_bodies(self) -> Self:
        if self.bodies[0] == self.bodies[1]:
            raise ValueError(f"{self.bodies[0]} is both bodies; name two")
        return self


class KeepOutRule(Model):
    """A body that is never in a region, which stands still."""

    body: Id
    region: ZoneShape
    distance: Length = Field(default=0, description="How far it stays from the region.")


class ZoneRule(Model):
    """What never happens: one of `apart`, `keep_out`, and `when` with `forbid`."""

    apart: ApartRule | None = None
    keep_out: KeepOutRule | None = None
    when: str | None = Field(default=None, max_length=200, description='A position of an axis, "detector.z < 50 mm".')
    forbid: str | None = Field(
        default=None, max_length=200, description='Another one, which is forbidden meanwhile, "sample.x > 120 mm".'
    )
    hysteresis: Quantity | None = Field(
        default=None,
        description="How far the axis of `when` must have left its end before the other one is free again.",
    )
    trust_step: bool = Field(
        default=False,
        description="Relies on all axes of a step keeping their times. Without it a step must be safe also where any "
        "axis stops while the others go on for their stop time.",
    )

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        names = [name for name in ("apart", "keep_out", "when") if getattr(self, name) is not None]
        if len(names) != 1 or (self.when is None) != (self.forbid is None):
            raise ValueError("state exactly one of `apart`, `keep_out`, and `when` with `forbid`")
        if self.when is None and self.hysteresis is not None:
            raise ValueError("`hysteresis` belongs to `when`; leave it out")
        for field in ("when", "forbid"):
            text = getattr(self, field)
            if text is not None and _RELATION.fullmatch(text) is None:
                raise ValueError(f'{field} is {text!r}; write an axis, < or >, and a position: "detector.z < 50 mm"')
        for block in (self.apart, self.keep_out):
            if block is not None and parse_quantity(block.distance, Unit.MM) < 0:
                raise ValueError(f"distance is {block.distance}; it must not be below 0")
        return self

    def list_bodies(self) -> list[str]:
        """The bodies that it names."""
        if self.apart is not None:
            return self.apart.bodies
        return [] if self.keep_out is None else [self.keep_out.body]


class Zones(Model):
    """Bodies and rules. Software that refuses to plan: no safety function."""

    bodies: dict[Id, ZoneBody] = Field(default={}, max_length=MAX_BODIES)
    rules: dict[Id, ZoneRule] = Field(default={}, max_length=MAX_RULES)
    ranges: dict[str, Annotated[list[Quantity], Field(min_length=2, max_length=2)]] = Field(
        default={},
        description="By real axis: where it can be at all, [least, most], from one end stop to the other. It counts as "
        "anywhere there while its position is not known. Default: its soft limits.",
    )
    homes_away: list[str] = Field(
        default=[],
        description="Real axes whose homing leads away from all bodies, from wherever they may stand; it is not "
        "checked.",
    )
    step_skew: Seconds = Field(
        default=0.05,
        gt=0,
        le=10,
        description="How far axes of one step may be apart in time with `trust_step`, and before a stop begins.",
    )


@dataclass(frozen=True, slots=True)
class Relation:
    """A position of an axis on one side of an end. is_below: it holds below the end."""

    axis: str
    is_below: bool
    end: Fraction


def read_relation(text: str, unit: Unit) -> Relation:
    """A relation of a rule. unit: of its axis. Raises `UnitError`."""
    match = _RELATION.fullmatch(text)
    assert match is not None, "the rule is valid"
    axis, sign, end = match.groups()
    return Relation(axis, sign == "<", parse_quantity(end, unit, axis))


def find_relation_axis(text: str) -> str:
    """The axis of a relation."""
    match = _RELATION.fullmatch(text)
    assert match is not None, "the rule is valid"
    return match.group(1)
