"""What the execution buffer and the prebuffer of an axis can hold."""

from dataclasses import dataclass
from fractions import Fraction

from sim.shrc203.axis import Axis
from sim.shrc203.path import Triple


@dataclass(frozen=True, slots=True, eq=False)
class Travel:
    """M:, A:, MP:, AP: on one axis: an amount or a target coordinate, pls."""

    axis: Axis
    absolute: bool
    pulses: int
    triple: Triple | None
    """Speeds given with MP or AP; None: the D: triple."""
    from_pre: bool

    @property
    def axes(self) -> tuple[Axis, ...]:
        return (self.axis,)


@dataclass(frozen=True, slots=True, eq=False)
class Jog:
    """J: on one axis: constant speed S in a direction (L4863)."""

    axis: Axis
    sign: int
    from_pre: bool = False
    triple: Triple | None = None

    @property
    def axes(self) -> tuple[Axis, ...]:
        return (self.axis,)


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """K: or KP:, linear interpolation by these amounts, pls."""

    axes: tuple[Axis, ...]
    pulses: tuple[int, ...]
    triple: Triple | None
    """Replaces the triple of the axis with the smallest number (L3867)."""
    from_pre: bool


@dataclass(frozen=True, slots=True, eq=False)
class Arc:
    """E:n or EP:n. `plane` are the arc axes; `linear` the axis of a helix."""

    form: int
    plane: tuple[Axis, Axis]
    linear: Axis | None
    ccw: bool
    values: tuple[int, ...]
    """c1, c2 or p1, p2, e1, e2, pls, relative to where the arc starts."""
    angle: Fraction | None
    """Degrees, forms 1 and 4."""
    rotations: int
    """Form 3."""
    rise: int
    """z of the helix forms, pls."""
    triple: Triple | None
    from_pre: bool

    @property
    def axes(self) -> tuple[Axis, ...]:
        return self.plane if self.linear is None else (*self.plane, self.linear)


@dataclass(frozen=True, slots=True, eq=False)
class WaitTime:
    """WT: timed standby, tenths of a second (L2623)."""

    axis: Axis
    tenths: int
    from_pre: bool = True

    @property
    def axes(self) -> tuple[Axis, ...]:
        return (self.axis,)


@dataclass(frozen=True, slots=True, eq=False)
class WaitInput:
    """WI: standby until the six inputs have exactly this value (L2674)."""

    axis: Axis
    pattern: int
    from_pre: bool = True

    @property
    def axes(self) -> tuple[Axis, ...]:
        return (self.axis,)


Interpolation = Line | Arc
Standby = WaitTime | WaitInput
Entry = Travel | Jog | Line | Arc | WaitTime | WaitInput
