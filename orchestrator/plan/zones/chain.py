"""Where a body is by the positions of the axes that carry it, and how far it moves with each of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property

from orchestrator.model.fleet import Fleet
from orchestrator.model.linear_map import LinearMap
from orchestrator.model.names import split_name
from orchestrator.model.units import Unit, convert_units
from orchestrator.model.zone_fields import Carrier, Vector, ZoneBody, to_direction, to_vector
from orchestrator.plan.zones.shapes import Shape, make_shape
from orchestrator.plan.zones.vectors import (
    NO_TURN,
    ORIGIN,
    Rotation,
    add,
    chain,
    dot,
    length,
    make_rotation,
    scale,
    subtract,
    turn,
    turn_back,
)

Box = Mapping[str, tuple[float, float]]
"""Between which motor positions real axes are, in their units."""


@dataclass(frozen=True, slots=True)
class LinearPart:
    """A sum of positions of real axes: offset + factor x position, …, exact."""

    factors: tuple[tuple[str, float], ...]
    offset: float

    def find_at(self, positions: Mapping[str, float]) -> float:
        """Its value."""
        return self.offset + sum(factor * positions[axis] for axis, factor in self.factors)

    def find_range(self, box: Box) -> tuple[float, float]:
        """Its least and its largest value."""
        low = high = self.offset
        for axis, factor in self.factors:
            ends = factor * box[axis][0], factor * box[axis][1]
            low, high = low + min(ends), high + max(ends)
        return low, high


def resolve_axis(fleet: Fleet, name: str, size: Fraction = Fraction(1)) -> LinearPart:
    """A real axis or a linear virtual one as a sum of real ones. size: of its unit in that of the result."""
    if name not in fleet.names.virtual:
        return LinearPart(((name, float(size)),), 0.0)
    group, _ = split_name(name)
    virtual_map = fleet.virtual_axes.maps[group]
    assert isinstance(virtual_map, LinearMap), "the zones are valid"
    row = virtual_map.virtual.index(name)
    factors = zip(virtual_map.real, virtual_map.matrix[row], strict=True)
    return LinearPart(
        tuple((real, float(factor * size)) for real, factor in factors if factor), float(virtual_map.offset[row] * size)
    )


@dataclass(frozen=True, slots=True)
class Joint:
    """One part of a chain: it moves what it carries along `direction`, or turns it about that through a point. way: mm
    or rad."""

    way: LinearPart
    direction: Vector
    through: Vector | None = None


@dataclass(frozen=True, slots=True)
class Pose:
    """A rotation, and a shift after it, mm."""

    rotation: Rotation = NO_TURN
    shift: Vector = ORIGIN

    def place(self, point: Vector) -> Vector:
        """A point of the body in the machine's frame."""
        return add(self.shift, point if self.rotation is NO_TURN else turn(self.rotation, point))


@dataclass(frozen=True, slots=True)
class Rates:
    """How fast the points of a body move with each axis, in a box, mm per unit of the axis. along: the velocity that
    all points have; beside: a bound of what any point has besides, in any direction."""

    along: dict[str, Vector] = field(default_factory=dict[str, Vector])
    beside: dict[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True, slots=True)
class PlacedShape:
    """A shape in the machine's frame."""

    shape: Shape
    pose: Pose

    @property
    def middle(self) -> Vector:
        return self.pose.place(self.shape.middle)

    def find_support(self, direction: Vector) -> Vector:
        """Its farthest point in a direction of length 1."""
        if self.pose.rotation is NO_TURN:
            return add(self.pose.shift, self.shape.find_support(direction))
        return self.pose.place(self.shape.find_support(turn_back(self.pose.rotation, direction)))


@dataclass(frozen=True)
class Body:
    """A shape on a chain of joints, from the machine's frame outwards. name: as messages call it."""

    name: str
    shape: Shape
    joints: tuple[Joint, ...] = ()

    @property
    def axes(self) -> list[str]:
        """The real axes that it depends on."""
        return list(dict.fromkeys(axis for joint in self.joints for axis, _ in joint.way.factors))

    @cached_property
    def _slides(self) -> Rates | None:
        """How fast it moves with each axis, if nothing turns it: everywhere the same."""
        if any(joint.through is not None for joint in self.joints):
            return None
        return self._find_rates(dict.fromkeys(self.axes, (0.0, 0.0)))

    def find_ball(self, box: Box) -> tuple[Vector, float]:
        """Middle and radius of a ball that it does not leave while its axes are in a box, mm."""
        middle = self.place_at({axis: (box[axis][0] + box[axis][1]) / 2 for axis in self.axes}).middle
        rates = self.find_rates(box)
        reach = sum(length(rate) * _half(box[axis]) for axis, rate in rates.along.items())
        return middle, self.shape.radius + reach + sum(rate * _half(box[axis]) for axis, rate in rates.beside.items())

    def without_first(self, count: int) -> "Body":
        """The body as seen from its joint number `count`."""
        return Body(self.name, self.shape, self.joints[count:])

    def place_at(self, positions: Mapping[str, float]) -> PlacedShape:
        """The body with its axes at positions."""
        pose = Pose()
        for joint in self.joints:
            pose = _follow(pose, joint, joint.way.find_at(positions))
        return PlacedShape(self.shape, pose)

    def find_rates(self, box: Box) -> Rates:
        """How fast its points move with each axis while all axes are in a box."""
        return self._slides or self._find_rates(box)

    def _find_rates(self, box: Box) -> Rates:
        """The same, worked out.

        A translation before any rotation moves all points alike. One behind a rotation moves them by as much, in a
        direction that changes. A rotation moves a point by its distance from the axis of rotation, which is at most
        that of the shape's middle in the middle of the box, the shape's radius, and what the joints behind it move
        the shape by in the box.
        """
        middle = {axis: (low + high) / 2 for axis, (low, high) in box.items()}
        lines: list[tuple[Vector, Vector]] = []
        pose = Pose()
        for joint in self.joints:
            origin = pose.place(ORIGIN if joint.through is None else joint.through)
            lines.append((origin, turn(pose.rotation, joint.direction)))
            pose = _follow(pose, joint, joint.way.find_at(middle))
        centre, reach = pose.place(self.shape.middle), self.shape.radius
        rates = Rates()
        turns_before = [any(e.through is not None for e in self.joints[:number]) for number in range(len(self.joints))]
        for joint, (origin, direction), turns in reversed(list(zip(self.joints, lines, turns_before, strict=True))):
            arm = 1.0
            if joint.through is not None:
                offset = subtract(centre, origin)
                arm = length(subtract(offset, scale(direction, dot(offset, direction)))) + reach
            for axis, factor in joint.way.factors:
                half = (box[axis][1] - box[axis][0]) / 2
                reach += abs(factor) * arm * half
                if joint.through is None and not turns:
                    shift = scale(joint.direction, factor)
                    rates.along[axis] = add(rates.along.get(axis, ORIGIN), shift)
                else:
                    rates.beside[axis] = rates.beside.get(axis, 0.0) + abs(factor) * arm
        return rates


def _half(ends: tuple[float, float]) -> float:
    return (ends[1] - ends[0]) / 2


def _follow(pose: Pose, joint: Joint, way: float) -> Pose:
    """The pose of what a joint carries. pose: of what carries the joint. way: mm or rad."""
    if joint.through is None:
        return Pose(pose.rotation, pose.place(scale(joint.direction, way)))
    rotation = make_rotation(joint.direction, way)
    shift = pose.place(subtract(joint.through, turn(rotation, joint.through)))
    return Pose(rotation if pose.rotation is NO_TURN else chain(pose.rotation, rotation), shift)


def make_body(fleet: Fleet, bodies: Mapping[str, ZoneBody], name: str) -> Body:
    """A body of a valid fleet file."""
    return Body(name, make_shape(bodies[name]), tuple(_make_joints(fleet, bodies, bodies[name].on)))


def _make_joints(fleet: Fleet, bodies: Mapping[str, ZoneBody], carriers: Sequence[Carrier]) -> list[Joint]:
    joints: list[Joint] = []
    for carrier in carriers:
        if carrier.body is not None:
            joints += _make_joints(fleet, bodies, bodies[carrier.body].on)
            continue
        assert carrier.axis is not None, "the zones are valid"
        unit = fleet.unit_of(carrier.axis)
        if carrier.along is not None:
            way = resolve_axis(fleet, carrier.axis, convert_units(Fraction(1), unit, Unit.MM))
            joints.append(Joint(way, to_direction(carrier.along)))
        elif carrier.about is not None:
            way = resolve_axis(fleet, carrier.axis, convert_units(Fraction(1), unit, Unit.RAD))
            joints.append(
                Joint(
                    way, to_direction(carrier.about), ORIGIN if carrier.through is None else to_vector(carrier.through)
                )
            )
    return joints
