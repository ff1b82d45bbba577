"""Contents of the execution buffer and the prebuffer of an axis."""

from dataclasses import dataclass
from fractions import Fraction

from sim.shrc203.axis import StageAxis
from sim.shrc203.path import SpeedTriple


@dataclass(frozen=True, slots=True, eq=False)
class TravelMove:
    """M:, A:, MP:, AP: on one axis: an amount or a target coordinate, pls."""

    axis: StageAxis
    absolute: bool
    pulses: int
    triple: SpeedTriple | None
    """Speeds given with MP or AP; None: the D: triple."""
    from_pre: bool

    @property
    def axes(self) -> tuple[StageAxis, ...]:
        return (self.axis,)


@dataclass(frozen=True, slots=True, eq=False)
class JogMove:
    """J: on one axis: constant speed S in a direction (L4863)."""

    axis: StageAxis
    sign: int
    from_pre: bool = False
    triple: SpeedTriple | None = None

    @property
    def axes(self) -> tuple[StageAxis, ...]:
        return (self.axis,)


@dataclass(frozen=True, slots=True, eq=False)
class LinearMove:
    """K: or KP:, linear interpolation by these amounts, pls."""

    axes: tuple[StageAxis, ...]
    pulses: tuple[int, ...]
    triple: SpeedTriple | None
    """Replaces the triple of the axis with the smallest number (L3867)."""
    from_pre: bool


@dataclass(frozen=True, slots=True, eq=False)
class ArcMove:
    """E:n or EP:n. `plane` are the arc axes; `linear` the axis of a helix."""

    form: int
    plane: tuple[StageAxis, StageAxis]
    linear: StageAxis | None
    ccw: bool
    values: tuple[int, ...]
    """c1, c2 or p1, p2, e1, e2, pls, relative to where the arc starts."""
    angle: Fraction | None
    """Degrees, forms 1 and 4."""
    rotations: int
    """Form 3."""
    rise: int
    """z of the helix forms, pls."""
    triple: SpeedTriple | None
    from_pre: bool

    @property
    def axes(self) -> tuple[StageAxis, ...]:
        return self.plane if self.linear is None else (*self.plane, self.linear)


@dataclass(frozen=True, slots=True, eq=False)
class TimedStandby:
    """WT: timed standby, tenths of a second (L2623)."""

    axis: StageAxis
    tenths: int
    from_pre: bool = True

    @property
    def axes(self) -> tuple[StageAxis, ...]:
        return (self.axis,)


@dataclass(frozen=True, slots=True, eq=False)
class InputStandby:
    """WI: standby until the six inputs have exactly this value (L2674)."""

    axis: StageAxis
    pattern: int
    from_pre: bool = True

    @property
    def axes(self) -> tuple[StageAxis, ...]:
        return (self.axis,)


Interpolation = LinearMove | ArcMove
Standby = TimedStandby | InputStandby
Entry = TravelMove | JogMove | LinearMove | ArcMove | TimedStandby | InputStandby


@dataclass(slots=True, eq=False)
class AxisBuffers:
    """Buffers of one axis."""

    execution: Entry | None = None
    executed: bool = False
    """The execution buffer's value has been run; it stays readable (decision 20)."""
    pre: Entry | None = None
    operation: Entry | None = None
    """The operation being executed from the buffers."""
