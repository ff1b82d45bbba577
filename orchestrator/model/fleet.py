"""The fleet file: controllers, their links, axes, inputs and outputs, wiring, groups."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, cast

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    ValidationInfo,
    field_validator,
    model_validator,
)

from orchestrator.model.alarm_rules import AlarmRules, NotifyCommand
from orchestrator.model.axis_units import SoftLimits, convert_rates
from orchestrator.model.base import Id, Model, Rational, UnknownName
from orchestrator.model.compensation import Backlash, Correction, Play
from orchestrator.model.fleet_names import DefinedNames, collect_names, find_reference_problems
from orchestrator.model.frame import FrameSpec
from orchestrator.model.links import (
    LINE_SETTINGS,
    AnyLink,
    CanBusLink,
    Link,
    SerialLink,
)
from orchestrator.model.names import split_name
from orchestrator.model.numbers import Duration, Hertz, Part, Seconds, SignedNumber, UnitNumber
from orchestrator.model.pairs.fields import explain_pair_field
from orchestrator.model.pairs.rack import MotorRack
from orchestrator.model.problems import Problem, raise_problems, validate_with
from orchestrator.model.queue import JournalPolicy, StartPolicy
from orchestrator.model.text.text_fields import PLAIN_TEXT
from orchestrator.model.units import Quantity, Unit, UnitError, find_dimension, parse_quantity
from orchestrator.model.virtual_axes import MAX_GROUPS, VirtualGroup, digest_corrections
from orchestrator.model.virtual_maps import VirtualAxes, find_virtual_problems, list_real_axes
from orchestrator.model.web_views import WebSettings
from orchestrator.model.zone_fields import Zones
from orchestrator.model.zone_problems import find_zone_problems

if TYPE_CHECKING:
    from orchestrator.model.tables.cubic import Array

MAX_COUNTS = 2**31  # controllers and drives keep positions in 32 bits
MAX_POSITIONS, MAX_DESCRIPTION = 1_000, 200  # named positions, characters
MAX_FRAMES = 200
WITHOUT_REFERENCES = object()
"""Context in which a fleet with a controller that is known to be wrong is validated: names are not looked up."""
MIN_SCALE, MAX_SCALE = Fraction(1, 10**6), 10**12  # counts per unit


class AxisLimits(Model):
    """The maximum velocity, acceleration and jerk of an axis, in its unit per second (², ³)."""

    velocity: UnitNumber
    acceleration: UnitNumber
    jerk: UnitNumber | None = Field(
        default=None, description="Without it the axis is planned with trapezoidal velocity profiles."
    )


class HomingSettings(Model):
    """How an axis finds its reference."""

    method: str = Field(default="default", description="A homing method of the make; `default` is its usual one.")
    direction: Literal["negative", "positive"] = Field(
        default="negative", description="Direction of the search, by positions in the axis's unit."
    )
    speed: UnitNumber | None = Field(default=None, description="Approach speed, unit/s; default: a tenth of the limit.")
    search_speed: UnitNumber | None = Field(
        default=None, description="Speed of the fine search, where the make supports it."
    )
    timeout_s: Seconds = Field(default=60.0, gt=0, le=3600)
    after: list[str] = Field(
        default=[], description="Axes `controller.axis` that must be referenced before this one is homed."
    )


class JogSettings(Model):
    """The speeds at which an axis may be jogged, in unit/s."""

    speed: UnitNumber | None = Field(
        default=None, description="Maximum jog speed; default: a quarter of the velocity limit."
    )
    slow_speed: UnitNumber | None = Field(
        default=None, description="Maximum jog speed while unreferenced; default: a fiftieth of the velocity limit."
    )


class HoldingBrake(Model):
    """A holding brake. Without `output`, the controller or its amplifier switches the brake together with the motor."""

    output: Id | None = Field(
        default=None, description="Named output of the same controller; active releases the brake."
    )
    release_s: Seconds = Field(
        default=0.0, ge=0, le=10, description="After enabling: time until the brake is open; no motion before."
    )
    engage_s: Seconds = Field(default=0.0, ge=0, le=10, description="Before disabling: time until the brake holds.")


class StartRate(Model):
    """For steppers: the speed range, in unit/s, in which the motor may start and stop without a ramp."""

    min: float = Field(ge=0)
    max: UnitNumber

    @model_validator(mode="after")
    def _check_order(self) -> "StartRate":
        if self.min > self.max:
            raise ValueError(f"start_rate.min ({self.min}) is above start_rate.max ({self.max}); swap them")
        return self


def _check_scale(scale: Fraction) -> Fraction:
    if scale <= 0:
        raise ValueError(f"scale is {scale}; it must be above 0 (use `sign: -1` to reverse the direction)")
    if not MIN_SCALE <= scale <= MAX_SCALE:
        raise ValueError(f"scale is {float(scale):g} counts per unit; it must be from {MIN_SCALE} to {MAX_SCALE}")
    return scale


MotorName = Annotated[str, BeforeValidator(lambda name: str(name) if type(name) is int else name)]
"""The make's name of a motor; `[1]` is `['1']`."""

Scale = Annotated[Rational, AfterValidator(_check_scale)]

SpeedSettings = TypeVar("SpeedSettings", HomingSettings, JogSettings, Backlash | None)


def _require_range(limits: SoftLimits, unit: Unit, scale: Fraction) -> None:
    """Raise `ValueError` for limits that are no range of counts."""
    low, high = limits.in_unit(unit)
    if low >= high:
        raise ValueError(f"soft_limits.min ({limits.min}) is not below max ({limits.max})")
    for name, end in (("min", low), ("max", high)):
        if abs(end * scale) > MAX_COUNTS:
            raise ValueError(
                f"soft_limits.{name} ({getattr(limits, name)}) is {float(end * scale):.4g} counts; positions are "
                f"within ±{MAX_COUNTS} counts"
            )


class Axis(Model):
    """One coordinate of the fleet."""

    motors: list[MotorName] = Field(
        min_length=1, max_length=2, description="The make's names, e.g. [X] or ['1']; two motors carry one beam."
    )
    unit: Unit
    description: Annotated[str, PLAIN_TEXT] = Field(
        default="", max_length=200, description="What the axis is, for people and for programs that describe it."
    )
    scale: Scale = Field(default=Fraction(1), description='Counts per unit, exact: 2000, "10000/3".')
    sign: Literal[1, -1] = Field(default=1, description="-1 if the controller counts in the opposite direction.")
    kind: Literal["linear", "rotary"] = "linear"
    wrap: Quantity | None = Field(default=None, description="Rotary axes: the length of one turn, e.g. 360.")
    shortest_way: bool = Field(
        default=False, description="Rotary axes: approach absolute targets in the shorter direction."
    )
    soft_limits: SoftLimits | None = None
    manual_speed: Part = Field(
        default=0.2, description="Fraction of the velocity limit for moves that a person asks for one at a time."
    )
    limits: AxisLimits
    start_rate: StartRate | None = None
    enable: Literal["manual", "per_job", "at_start"] = "manual"
    on_estop: Literal["hold", "disable"] = Field(
        default="hold",
        description="hold: the motor stays on; disable: the motor is switched off once the axis is at rest.",
    )
    brake: HoldingBrake | None = None
    jog: JogSettings = JogSettings()
    homing: HomingSettings = HomingSettings()
    done: Literal["profile", "in_position"] = "profile"
    in_position_window: UnitNumber | None = Field(
        default=None, validate_default=True, description="In the axis's unit; required with `done: in_position`."
    )
    in_position_timeout_s: Seconds = Field(default=2.0, gt=0, le=600)
    following_error: UnitNumber | None = Field(
        default=None, description="In the axis's unit; a larger following error is a fault."
    )
    max_deviation: UnitNumber | None = Field(
        default=None, validate_default=True, description="How far its two motors may be apart, in the axis's unit."
    )
    may_rack: UnitNumber | None = Field(
        default=None,
        validate_default=True,
        exclude_if=lambda length: length is None,
        description="The same after any single fault, which bounds its speed; default: twice `max_deviation`.",
    )
    square: SignedNumber = Field(
        default=0.0,
        exclude_if=lambda length: not length,
        description="Where the second motor is, from its own reference, with the beam square and the first one at its.",
    )
    backlash: Backlash | None = Field(
        default=None,
        exclude_if=lambda backlash: backlash is None,
        description="Play of its drive, which is made up for.",
    )
    correction: Correction | None = Field(
        default=None,
        exclude_if=lambda correction: correction is None,
        description="Measured errors of its position, which are corrected.",
    )

    @model_validator(mode="wrap")
    @classmethod
    def _convert_units(cls, data: Any, handler: ModelWrapValidatorHandler["Axis"]) -> "Axis":
        plain, problems = convert_rates(data)
        return validate_with(problems, cls.__name__, lambda: handler(plain))

    @field_validator("unit")
    @classmethod
    def _check_unit(cls, unit: Unit) -> Unit:
        if find_dimension(unit) == "energy":
            raise ValueError(f"an axis moves, and {unit} is a unit of energy; make it a virtual axis, `kind: energy`")
        return unit

    # Each check belongs to the last of its fields, so that a mistake elsewhere in the axis does not hide it.

    @field_validator("wrap")
    @classmethod
    def _check_wrap(cls, wrap: int | float | str | None, info: ValidationInfo) -> int | float | str | None:
        if wrap is not None and info.data.get("kind") == "linear":
            raise ValueError("wrap and shortest_way need `kind: rotary`")
        if wrap is not None and "unit" in info.data and parse_quantity(wrap, info.data["unit"]) <= 0:
            raise ValueError("wrap must be above 0")
        return wrap

    @field_validator("shortest_way")
    @classmethod
    def _check_shortest_way(cls, shortest_way: bool, info: ValidationInfo) -> bool:  # noqa: FBT001 - called by pydantic
        if shortest_way and info.data.get("kind") == "linear":
            raise ValueError("wrap and shortest_way need `kind: rotary`")
        if shortest_way and info.data.get("wrap", 1) is None:
            raise ValueError("shortest_way needs `wrap`, the length of one turn")
        return shortest_way

    @field_validator("soft_limits")
    @classmethod
    def _check_soft_limits(cls, limits: SoftLimits | None, info: ValidationInfo) -> SoftLimits | None:
        if limits is not None and "unit" in info.data:
            _require_range(limits, info.data["unit"], info.data.get("scale", 1))
        return limits

    @field_validator("homing", "jog", "backlash")
    @classmethod
    def _check_speeds(cls, settings: SpeedSettings, info: ValidationInfo) -> SpeedSettings:
        limits: AxisLimits | None = info.data.get("limits")
        for name in ("speed", "search_speed", "slow_speed"):
            speed = getattr(settings, name, None)
            if limits is not None and speed is not None and speed > limits.velocity:
                raise ValueError(f"{info.field_name}.{name} ({speed:g}) is above limits.velocity ({limits.velocity:g})")
        return settings

    @field_validator("in_position_window")
    @classmethod
    def _check_window(cls, window: float | None, info: ValidationInfo) -> float | None:
        if window is None and info.data.get("done") == "in_position":
            raise ValueError("`done: in_position` needs in_position_window")
        return window

    @field_validator("max_deviation", "may_rack", "square")
    @classmethod
    def _check_pair(cls, value: float | None, info: ValidationInfo) -> float | None:
        if text := explain_pair_field(info.field_name or "", value, info.data):
            raise ValueError(text)
        return value

    @field_validator("correction")
    @classmethod
    def _check_correction(cls, correction: Correction | None, info: ValidationInfo) -> Correction | None:
        if correction is not None and "unit" in info.data and "soft_limits" in info.data:
            limits, unit, wraps = info.data["soft_limits"], info.data["unit"], info.data.get("wrap") is not None
            ends = limits and [parse_quantity(end, unit) for end in (limits.min, limits.max)]
            raise_problems(correction.find_problems(ends, unit, wraps=wraps), cls.__name__)
        return correction

    @cached_property
    def counts_per_unit(self) -> Fraction:
        """Signed counts of the controller per unit."""
        return self.scale * self.sign

    @property
    def is_compensated(self) -> bool:
        """Whether its position differs from that of its motor."""
        return self.backlash is not None or self.correction is not None

    @property
    def homing_sign(self) -> Literal[1, -1]:
        """The direction of its reference search in counts; `homing.direction` is that of its unit."""
        return 1 if (self.homing.direction == "positive") == (self.sign > 0) else -1

    @cached_property
    def rack(self) -> MotorRack | None:
        """How far its two motors may be apart; None for an axis of one motor."""
        deviation = self.max_deviation
        return None if deviation is None else MotorRack.of(deviation, self.following_error, self.may_rack)

    def jog_speed(self, *, referenced: bool) -> float:
        """The maximum jog speed, unit/s; lower while the axis is unreferenced, and bounded by `may_rack`."""
        fast = self.jog.speed or self.limits.velocity / 4
        if self.rack is not None:
            fast = min(fast, self.rack.fastest(self.limits.acceleration))
        return fast if referenced else min(fast, self.jog.slow_speed or self.limits.velocity / 50)

    def to_counts(self, position: Fraction) -> int:
        """The nearest count at which the motor has the axis at a position (in the axis's unit)."""
        return round(self._find_motor(position) * self.counts_per_unit)

    def to_target_counts(self, position: Fraction) -> int:
        """The count for a target, a position in the axis's unit without user offset: the nearest one; of a target
        inside the soft limits the nearest one inside, where a limit is no whole number of counts."""
        counts, limits, exact = self.to_counts(position), self.soft_limits_counts, self._exact_soft_limits
        if limits is None or exact is None:
            return counts
        if not exact[0] <= self._find_motor(position) * self.counts_per_unit <= exact[1]:
            return counts
        return min(max(counts, limits[0]), limits[1])

    def to_position(self, counts: int | Fraction) -> Fraction:
        """The exact position of the axis, in its unit, where its motor is at `counts`, without play."""
        motor = Fraction(counts) / self.counts_per_unit
        return motor if self.correction is None else motor + self.correction.table.find_error(motor)

    def to_unit(self, counts: float) -> float:
        """The position of the axis, in its unit, where its motor is at `counts`, without play."""
        if self.correction is None:
            return counts / self._float_scale
        return float(self.to_position(Fraction(counts)))

    def to_units(self, counts: "Array") -> "Array":
        """`to_unit` for many counts."""
        motors = counts / self._float_scale
        return motors if self.correction is None else motors + self.correction.table.evaluate(motors)

    def to_length(self, counts: float) -> float:
        """Convert a distance of its motor, or a speed, to the axis's unit: with the scale alone."""
        return counts / self._float_scale

    def _find_motor(self, position: Fraction) -> Fraction:
        """The position of the motor, in the axis's unit, at which the axis is at `position`."""
        return position if self.correction is None else self.correction.table.invert(position)

    @cached_property
    def play(self) -> Play | None:
        """The play of its drive, counts; None without any. An axis is 0 ahead of its motor after a motion in the
        direction of `approach` (positive without one), in which tables and references count."""
        return None if self.backlash is None else self.backlash.count_play(self.scale, self.sign)

    @cached_property
    def turn_length(self) -> Fraction | None:
        """The length of one turn in the axis's unit; None for an axis that does not wrap."""
        return None if self.wrap is None else parse_quantity(self.wrap, self.unit)

    def wrap_position(self, position: float) -> float:
        """Wrap a user position for display into one turn, from 0; unchanged for an axis that does not wrap."""
        if self.turn_length is None:
            return position
        position_within = position % float(self.turn_length)
        # A value slightly below 0 is rounded up to a whole turn.
        return position_within if position_within < float(self.turn_length) else 0.0

    @cached_property
    def _float_scale(self) -> float:
        return float(self.counts_per_unit)

    @cached_property
    def soft_limits_counts(self) -> tuple[int, int] | None:
        """The soft limits as (low, high) counts of the controller, rounded inwards, without play; None without
        limits."""
        if self._exact_soft_limits is None:
            return None
        low, high = self._exact_soft_limits
        return -((-low.numerator) // low.denominator), high.numerator // high.denominator

    @cached_property
    def motor_limits_counts(self) -> tuple[int, int] | None:
        """The soft limits as (low, high) counts that the motor may reach: with the play that it takes up on its way to
        them."""
        limits, play = self.soft_limits_counts, self.play
        return limits if limits is None or play is None else (limits[0] - play.most, limits[1] - play.least)

    @cached_property
    def _exact_soft_limits(self) -> tuple[Fraction, Fraction] | None:
        """The soft limits as (low, high) counts, not rounded."""
        if self.soft_limits is None:
            return None
        low, high = sorted(self._find_motor(end) * self.counts_per_unit for end in self.soft_limits.in_unit(self.unit))
        return low, high


class DigitalInput(Model):
    """A named digital input."""

    number: int = Field(ge=1, le=65_535)
    active: Literal["high", "low"] = "high"


class DigitalOutput(Model):
    """A named digital output."""

    number: int = Field(ge=1, le=65_535)
    active: Literal["high", "low"] = "high"
    safe: bool | None = Field(
        default=None, description="State to set on an e-stop, true: active; none: leave unchanged."
    )


class StateRates(Model):
    """How often a controller's state is read and published, in Hz."""

    moving_hz: Hertz = Field(
        default=10.0, ge=3, le=200, description="A controller that is silent for 0.7 s in motion is stopped."
    )
    idle_hz: Hertz = Field(default=5.0, gt=0, le=200)


class AxisMechanics(Model):
    """What is behind the motor of a simulated axis, in the axis's unit: for `backlash` and `correction`."""

    backlash: float = Field(default=0.0, ge=0)
    errors: list[list[float]] = Field(
        default=[], description="`[position of the motor, error]`, sorted; straight between them."
    )
    errors_of: dict[str, list[list[float]]] = Field(
        default={},
        description="The same by another axis, whose motor moves this one as well: of the controller, or of another "
        "one, `controller.axis`.",
    )


class SimulationSettings(Model):
    """How a controller is simulated, for `--sim` and tests: the simulator's options and the timing of its firmware and
    crystal."""

    options: dict[str, Any] = Field(default={}, description="The simulator's own options.")
    decode_us: int | None = Field(
        default=None,
        ge=0,
        le=10_000_000,
        description="Time that the firmware takes for a command. None: 500 µs, or, with its spread, what the options "
        "of the adapter state, where those exclude that.",
    )
    spread_us: int = Field(default=0, ge=0, le=10_000_000, description="Random extra time, up to this.")
    offset_s: float = Field(default=0.0, ge=0, le=1e9, description="The controller's clock at the start.")
    drift_ppm: float = Field(default=0.0, ge=-1000, le=1000)
    wander_ppm: float = Field(default=0.0, ge=0, le=10, description="Random walk of the rate, ppm per √s.")
    hold_ms: float = Field(default=0.0, ge=0, le=100, description="Maximum receive delay of a USB serial adapter.")
    link: Link | None = Field(default=None, description="Where the simulator listens; set by `--sim`.")
    mechanics: dict[Id, AxisMechanics] = Field(
        default={}, description="What is behind the motors, by axis; only tests can see it."
    )


class Controller(Model):
    """One physical motion controller."""

    adapter: str = Field(description="The adapter of its make, e.g. smc4000, shrc203.")
    link: Link
    host: Id = Field(default="local", description="The adapter host that drives it.")
    options: dict[str, Any] = Field(default={}, description="Options of the adapter.")
    simulate: SimulationSettings = SimulationSettings()
    axes: dict[Id, Axis] = Field(min_length=1)
    inputs: dict[Id, DigitalInput] = Field(default={})
    outputs: dict[Id, DigitalOutput] = Field(default={})
    state: StateRates = StateRates()
    corrections: str = Field(
        default="",
        max_length=64,
        exclude_if=lambda digest: not digest,
        description="A digest of the `corrected` virtual axes that its axes belong to; set by the fleet file.",
    )

    @property
    def shares_port(self) -> bool:
        """Whether other controllers may be on the same port."""
        return _address_of(self) is not None

    @property
    def link_to_open(self) -> AnyLink:
        """The link to open: that of the controller, or of the simulator that replaces it."""
        return self.simulate.link or self.link

    @property
    def line(self) -> str:
        """The port, bus or address that it is on. Each computer has ports of its own; an address is common to all."""
        is_local = isinstance(self.link, SerialLink | CanBusLink) and self.host != "local"
        return f"{self.link.endpoint} of {self.host}" if is_local else self.link.endpoint

    @property
    def full_ramps_s(self) -> list[float]:
        """How long the ramp of each axis takes from its highest speed, s."""
        return [axis.limits.velocity / axis.limits.acceleration for axis in self.axes.values()]

    @cached_property
    def digest(self) -> str:
        """A digest of this configuration: equal digests mean equal configuration on both sides of the bus."""
        plain = {name: value for name, value in self.to_plain().items() if name != "simulate"}
        # What an axis is called changes no motion.
        for axis in plain["axes"].values():
            del axis["description"]
        # Line settings concern the adapter alone, which completes them by its make.
        plain["link"] = {name: value for name, value in plain["link"].items() if name not in LINE_SETTINGS}
        text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def _make_tuple(value: Any) -> Any:
    """A list of a file; a strict tuple would refuse it."""
    return tuple(cast(list[Any], value)) if isinstance(value, list) else value


class TriggerWire(Model):
    """An output of one controller that is wired to inputs of others, so that it can start their moves."""

    from_: str = Field(alias="from", description="controller.output")
    to: list[str] = Field(min_length=1, description="controller.input, one or more")
    delay_us: Annotated[tuple[int, int], BeforeValidator(_make_tuple)] = Field(
        default=(0, 50), description="Minimum and maximum delay from the output to an input's terminal, µs."
    )

    @model_validator(mode="after")
    def _check_possible(self) -> "TriggerWire":
        least_us, most_us = self.delay_us
        if not 0 <= least_us <= most_us <= 100_000:
            raise ValueError(f"delay_us is [{least_us}, {most_us}]; it must be [least, most], from 0 to 100000")
        repetitions = sorted({end for end in self.to if self.to.count(end) > 1})
        if repetitions:
            raise ValueError(f"{repetitions[0]} is listed twice in `to`; list each input once")
        return self


@dataclass(frozen=True, slots=True)
class WireConnection:
    """One wire from an output to an input, each by controller, name and definition."""

    source: str
    output: str
    driven_by: DigitalOutput
    target: str
    input: str
    feeds: DigitalInput
    delay_us: tuple[int, int]

    def input_level(self, *, on: bool) -> bool:
        """The input's electrical level while the output is `on`; the wiring makes both active at the same time."""
        return (on == (self.driven_by.active == "high")) == (self.feeds.active == "high")


class Permit(Model):
    """A condition that must hold before axes are armed; its loss stops the step that moves them."""

    input: str = Field(description="controller.input")
    value: bool = Field(default=True, description="true: the input must be active")
    axes: list[str] | None = Field(default=None, description="Axes, groups or controllers; none: the whole fleet.")
    settle: Duration = Field(default=0, ge=0, description="How long it must have held before anything moves.")
    on_clear: Literal["ask", "begin"] | None = Field(
        default=None,
        description="What happens to jobs that waited for it once it holds, instead of `queue.on_clear`. `begin` is "
        "only for a guard that people do not walk through.",
    )


def _read_short_position(data: Any) -> Any:
    """`{gantry.x: 120 mm}` is `{axes: {gantry.x: 120 mm}}`; only axes have a dot in their names."""
    plain = cast(Mapping[str, Any], data)
    if not isinstance(data, Mapping) or "axes" in plain:
        return plain
    fields = {name: value for name, value in plain.items() if "." not in name}
    return {**fields, "axes": {name: value for name, value in plain.items() if "." in name}}


def _describe_short_position(schema: dict[str, Any]) -> None:
    """In a file the axes may stand beside the description."""
    schema["additionalProperties"] = {"anyOf": [{"type": "number"}, {"type": "string"}]}
    schema.pop("required", None)


class NamedPosition(Model):
    """A named position of axes, in user positions, like the targets of jobs: `{gantry.x: 120 mm, stage.u: 5 mm}`."""

    model_config = ConfigDict(json_schema_extra=_describe_short_position)

    description: str = Field(default="", max_length=MAX_DESCRIPTION)
    axes: dict[str, Quantity] = Field(
        min_length=1, description="User positions by axis; they may also stand in the place of `axes` themselves."
    )

    _short = model_validator(mode="before")(_read_short_position)


class QueuePolicy(Model):
    """What happens to waiting jobs after a break and after a failure.

    A break is a restart of the fleet, an interrupted step, or a controller that was off, restarted or unreferenced.
    """

    on_restart: Literal["stop", "continue"] = Field(
        default="stop", description="stop: after a break no waiting job begins until `tutti queue start`."
    )
    on_failure: Literal["hold", "continue"] = Field(
        default="hold", description="hold: waiting jobs that need a controller of a failed job are held."
    )
    on_clear: Literal["ask", "begin"] = Field(
        default="ask",
        description="ask: a job that had to wait for a permit, an e-stop, a fault, a reference, a motor or a "
        "controller begins only by `tutti queue start` or `tutti job release`; begin: as soon as the cause is gone.",
    )


class Fleet(Model):
    """All controllers that share one name space on the bus."""

    schema_: Literal["tutti.fleet/1"] = Field(alias="schema")
    fleet: Id
    controllers: dict[Id, Controller] = Field(min_length=1)
    wiring: list[TriggerWire] = Field(default=[])
    permits: dict[Id, Permit] = Field(default={}, description='Named conditions, such as "door-closed".')
    groups: dict[Id, list[str]] = Field(default={}, description="Named groups of axes, `controller.axis`.")
    home_order: list[str] = Field(default=[], description="Groups, controllers or axes, homed one after another.")
    positions: dict[Id, NamedPosition] = Field(
        default={}, max_length=MAX_POSITIONS, description="Named positions, for the targets of jobs and commands."
    )
    frames: dict[Id, FrameSpec] = Field(
        default={}, max_length=MAX_FRAMES, description="Coordinates for paths: named maps from coordinates to axes."
    )
    virtual: dict[Id, VirtualGroup] = Field(
        default={}, max_length=MAX_GROUPS, description="Virtual axes `group.axis`, which stand for several real ones."
    )
    zones: Zones | None = Field(
        default=None,
        exclude_if=lambda zones: zones is None,
        description="Bodies that must not collide, positions that exclude each other: software, no safety function.",
    )
    routers: list[str] = Field(
        default=[],
        max_length=8,
        description="Routers of the fleet, e.g. tls/lab-a:7447, which `tutti up` uses instead of starting one. Of "
        "several, another one is used when one goes away.",
    )
    queue: QueuePolicy = QueuePolicy()
    starts: StartPolicy = Field(
        default_factory=StartPolicy,
        exclude_if=lambda policy: policy == StartPolicy(),
        description="Time for agreed starts, on a computer that is busy at times.",
    )
    journal: JournalPolicy = Field(
        default_factory=JournalPolicy,
        exclude_if=lambda policy: policy == JournalPolicy(),
        description="Copies and lease of a journal in a database.",
    )
    alarms: AlarmRules = Field(default_factory=AlarmRules, description="What raises an alarm, by kind of alarm.")
    notify: NotifyCommand | None = Field(default=None, description="The command that is run for alarms.")
    web: WebSettings = Field(
        default_factory=WebSettings, description="What the operators' page shows besides the fleet: cameras."
    )
    integrations: dict[Id, dict[str, Any]] = Field(
        default={},
        max_length=16,
        exclude_if=lambda sections: not sections,
        description="Settings of servers for other clients, each under the name of its command, such as `ros2`; read "
        "and checked by these alone.",
    )

    @field_validator("controllers")
    @classmethod
    def _check_shared_links(cls, controllers: dict[str, Controller]) -> dict[str, Controller]:
        raise_problems(_find_link_problems(controllers), cls.__name__)
        return controllers

    @model_validator(mode="wrap")
    @classmethod
    def _check_names(cls, data: Any, handler: ModelWrapValidatorHandler["Fleet"], info: ValidationInfo) -> "Fleet":
        """Check references by the names that the file has, also when other parts of it are wrong."""
        problems = [] if info.context is WITHOUT_REFERENCES else find_reference_problems(data)
        return validate_with(problems, cls.__name__, lambda: handler(data))

    @model_validator(mode="after")
    def _check_virtual(self) -> "Fleet":
        """The maps of virtual axes; the names of their real axes are checked with the others."""
        raise_problems(find_virtual_problems(self.virtual, self.axis), type(self).__name__)
        for name, config in self.controllers.items():
            digest = digest_corrections(self.virtual, name)
            if config.corrections != digest:
                self.controllers[name] = config.model_copy(update={"corrections": digest})
        return self

    @model_validator(mode="after")
    def _check_positions(self) -> "Fleet":
        """Units and soft limits of named positions; their axes are checked with the other names."""
        problems: list[Problem] = []
        known_names = {*self.names.axes, *self.names.virtual}
        for name, position in self.positions.items():
            for axis, value in position.axes.items():
                text = self._explain_position(axis, value) if axis in known_names else None
                if text is not None:
                    problems.append(Problem(("positions", name, "axes", axis), text, value))
        raise_problems(problems, type(self).__name__)
        return self

    @model_validator(mode="after")
    def _check_frames(self) -> "Fleet":
        """Units of the axes of frames, and of their offsets; their names are checked with the others."""
        problems: list[Problem] = []
        for name, frame in self.frames.items():
            for number, axis in enumerate(frame.axes):
                if axis not in self.names.axes:
                    continue
                unit = self.axis(axis).unit
                if unit != frame.unit:
                    text = f"axis {axis} is in {unit}, and the coordinates in {frame.unit}; both must have one unit"
                    problems.append(Problem(("frames", name, "axes", number), text, axis))
                elif frame.offset is not None:
                    try:
                        parse_quantity(frame.offset[number], unit)
                    except UnitError as error:
                        problems.append(Problem(("frames", name, "offset", number), str(error), frame.offset[number]))
        raise_problems(problems, type(self).__name__)
        return self

    @model_validator(mode="after")
    def _check_zones(self) -> "Fleet":
        """The bodies, names and units of zones."""
        if self.zones is not None:
            problems = find_zone_problems(self.zones, self)
            raise_problems([replace(e, place=("zones", *e.place)) for e in problems], type(self).__name__)
        return self

    def _explain_position(self, axis: str, value: int | float | str) -> str | None:
        """Why `value` cannot be a position of `axis` without a user offset; None if it can."""
        if axis in self.names.virtual:
            return self.virtual_axes.explain_target(axis, value)
        config = self.axis(axis)
        try:
            position = parse_quantity(value, config.unit)
        except UnitError as error:
            return str(error)
        limits = config.soft_limits_counts
        # On an axis that wraps, a position exists once in each turn.
        if (
            limits is None
            or config.turn_length is not None
            or limits[0] <= config.to_target_counts(position) <= limits[1]
        ):
            return None
        low, high = sorted(config.to_unit(limit) for limit in limits)
        return f"{value} is beyond the soft limits of {axis}, {low:g} to {high:g} {config.unit}; change one of them"

    @cached_property
    def digest(self) -> str:
        """A digest of what all processes of a fleet must have alike: all but `notify`, `web`, `integrations` and the
        simulation."""
        plain = self.model_copy(update={"notify": None, "integrations": {}}).to_plain()
        del plain["web"]  # only the page depends on it
        plain["controllers"] = {name: [config.host, config.digest] for name, config in self.controllers.items()}
        text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def hosts(self) -> list[str]:
        """The adapter hosts that controllers name, in their order."""
        return list(dict.fromkeys(config.host for config in self.controllers.values()))

    @property
    def connections(self) -> list[WireConnection]:
        """All wires of the fleet, one entry per output and input."""
        found_connections: list[WireConnection] = []
        for wire in self.wiring:
            source, output = split_name(wire.from_)
            for end in wire.to:
                target, name = split_name(end)
                driven_by, feeds = self.controllers[source].outputs[output], self.controllers[target].inputs[name]
                found_connections.append(
                    WireConnection(
                        source=source,
                        output=output,
                        driven_by=driven_by,
                        target=target,
                        input=name,
                        feeds=feeds,
                        delay_us=wire.delay_us,
                    )
                )
        return found_connections

    def permits_of(self, axes: Iterable[str]) -> dict[str, Permit]:
        """The permits that bind any of `axes`, by name."""
        wanted_axes = set(axes)
        return {
            name: permit
            for name, permit in self.permits.items()
            if permit.axes is None or wanted_axes & {axis for name in permit.axes for axis in self.expand_name(name)}
        }

    @cached_property
    def names(self) -> DefinedNames:
        """All names of the fleet."""
        return collect_names(self.to_plain())

    def axis(self, name: str) -> Axis:
        """The axis `controller.axis`. Raises `UnknownName`, which lists the known axes."""
        controller, axis = split_name(name)
        if controller not in self.controllers or axis not in self.controllers[controller].axes:
            raise UnknownName(name, self.names.explain_unknown(name, "axis") or name)
        return self.controllers[controller].axes[axis]

    @cached_property
    def virtual_axes(self) -> VirtualAxes:
        """The virtual axes, with the maps to their real ones."""
        return VirtualAxes(self.virtual, self.axis)

    @cached_property
    def path_frames(self) -> Mapping[str, FrameSpec]:
        """The frames in which paths can be given, with those of virtual axes."""
        return {**self.virtual_axes.frames, **self.frames}

    def unit_of(self, name: str) -> Unit:
        """The unit of an axis, also of a virtual one. Raises `UnknownName`."""
        return self.virtual_axes.unit_of(name) if name in self.names.virtual else self.axis(name).unit

    @property
    def axis_names(self) -> list[str]:
        """All axes, as `controller.axis`, in the order of the file."""
        return [f"{c}.{a}" for c, controller in self.controllers.items() for a in controller.axes]

    def has_axis(self, name: str) -> bool:
        """Whether there is an axis of this name, `controller.axis`; a virtual one is none."""
        controller, axis = split_name(name)
        return controller in self.controllers and axis in self.controllers[controller].axes

    def expand_name(self, name: str) -> list[str]:
        """The axes that `name` stands for: a group, a controller, one axis, or the real axes of virtual ones. Raises
        `UnknownName`."""
        if name in self.virtual or name in self.names.virtual:
            return list_real_axes(self.virtual, split_name(name)[0])
        if name in self.groups:
            return list(self.groups[name])
        if name in self.controllers:
            return [f"{name}.{axis}" for axis in self.controllers[name].axes]
        text = self.names.explain_unknown(name, "axes")
        if text is not None:
            raise UnknownName(name, text)
        return [name]

    def find_real_axes(self, names: Iterable[str]) -> list[str]:
        """Axes with those that virtual ones stand for in their place, each once, in order; other names as they are."""
        virtual = self.names.virtual
        axes = (axis for name in names for axis in (self.expand_name(name) if name in virtual else (name,)))
        return list(dict.fromkeys(axes))

    def expand_names(self, names: Iterable[str]) -> list[str]:
        """The axes that `names` stand for, each once, in order. Raises `UnknownName`."""
        return list(dict.fromkeys(axis for name in names for axis in self.expand_name(name)))


def _address_of(controller: Controller) -> int | None:
    """Its address on its port or bus."""
    return controller.link.address if isinstance(controller.link, SerialLink | CanBusLink) else None


def _find_link_problems(controllers: dict[str, Controller]) -> list[Problem]:
    """Controllers on one port that cannot share it."""
    lines: dict[str, list[str]] = {}
    for name, controller in controllers.items():
        lines.setdefault(controller.line, []).append(name)
    problems: list[Problem] = []
    for line, names in lines.items():
        first = names[0]
        for number, name in enumerate(names[1:], 1):
            text = _explain_unshareable(line, first, controllers[first], name, controllers[name])
            address = _address_of(controllers[name])
            twin = next(
                (other_name for other_name in names[:number] if _address_of(controllers[other_name]) == address), None
            )
            if text is None and twin is not None:
                text = f"{twin} and {name} both have address {address} on {line}; give each its own address"
            if text is not None:
                problems.append(Problem((name, "link"), text))
    return problems


def _explain_unshareable(place: str, first: str, one: Controller, second: str, other: Controller) -> str | None:
    """Why both controllers cannot be reached through one port; None if they can."""
    pair = f"{first} and {second} are both on {place}"
    for name, controller in ((first, one), (second, other)):
        if _address_of(controller) is None:
            return (
                f"{pair}; a port can carry several controllers only if each has an address there, and {name} has none "
                "(link.address)"
            )
    if one.adapter != other.adapter:
        return f"{pair}, but have different `adapter`: {one.adapter} and {other.adapter}"
    alike = one.link.model_copy(update={"address": None}), other.link.model_copy(update={"address": None})
    if alike[0] != alike[1]:
        return f"{pair}, but with different settings: {alike[0].to_plain()} and {alike[1].to_plain()}"
    return None


def group_by_link(controllers: Mapping[str, Controller]) -> list[list[str]]:
    """The names of the controllers on each serial line or bus."""
    lines: dict[str, list[str]] = {}
    for name, controller in controllers.items():
        lines.setdefault(controller.line, []).append(name)
    return list(lines.values())


def group_by_controller(axes: Iterable[str]) -> dict[str, list[str]]:
    """Group axes `controller.axis` by their controller, in order."""
    groups: dict[str, list[str]] = {}
    for axis in axes:
        controller, name = split_name(axis)
        groups.setdefault(controller, []).append(name)
    return groups
