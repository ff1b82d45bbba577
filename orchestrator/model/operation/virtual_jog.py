"""How virtual axes are jogged: the speeds of their real axes, and how far the others of the group may leave their
position.

The velocity changes by steps that all real axes are sent at once, each small enough for the slowest of them. A step of
its speed by dv takes a real axis at most the period of steps, and comes at an instant of its own. From rest to rest,
with one speed between, a real axis is at most v x (STEP_S / 2 + apart_s) from where the others have it: so each other
virtual axis is off by at most the sum of |m| times that, with m its factor; twice as many changes of speed add as much
again. Play of a drive adds its width, an error table its span: a jog does not follow them. Controllers round
speeds to ROUNDED_COUNTS_S and have crystals of their own, which adds up with time.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from pydantic import Field

from orchestrator.model.base import Id, Model
from orchestrator.model.fleet import Axis
from orchestrator.model.linear_map import CorrectedMap, LinearMap, MapError
from orchestrator.model.names import split_name
from orchestrator.model.state import AxisState
from orchestrator.model.virtual_axes import VirtualAxis
from orchestrator.model.virtual_maps import VirtualMap

STEP_S = 0.05
"""The period of the steps of the common ramp, at most."""
TAKE_S = 0.02
"""By how much instants may differ at which controllers take one request, besides a poll that it waits for."""
ROUNDED_COUNTS_S = 2.0
"""Of a speed: the even numbers of counts/s of a make whose registers take no others (SMC-4000, L10032)."""
CRYSTAL_PPM = 100.0


class VirtualJog(Model):
    """How a virtual axis is jogged now, in its unit, while the others of its group keep their positions.

    rates: the velocity of each real axis of the group, in the order of `of`, per unit/s. speed: the highest.
    acceleration: of the common ramp, so that no real axis is asked for more than its own. off: how far each other
    virtual axis of the group may be off its position, in its unit, by a jog from rest to that speed and to rest; play:
    by how much more because of play and errors of real axes; drift: by how much more per second. deviations: the
    `jog.deviation` of those that have one. low, high: how far it can go, in both directions, until `low_by`, `high_by`
    is at its soft limit; None: without one. reach: how far one jog goes, of a pair; None: to these ends.
    """

    rates: list[float]
    speed: float = Field(ge=0)
    acceleration: float = Field(gt=0)
    off: dict[Id, float]
    play: dict[Id, float] = Field(default={})
    drift: dict[Id, float]
    deviations: dict[Id, float]
    low: float | None = None
    high: float | None = None
    low_by: str = ""
    high_by: str = ""
    reach: float | None = Field(default=None, exclude_if=lambda reach: reach is None)
    lacks_tables: bool = Field(default=False, exclude_if=lambda lacks_tables: not lacks_tables)

    @property
    def is_common(self) -> bool:
        """Whether it moves several real axes, which need a common ramp."""
        return sum(1 for rate in self.rates if rate) > 1


class RealJog(NamedTuple):
    """A real axis of a group, `controller.axis`, with its configuration and its state. room: between which motor
    positions zones allow it to be jogged; None: everywhere."""

    name: str
    config: Axis
    state: AxisState
    room: tuple[float, float] | None = None


class _Reach(NamedTuple):
    """How far an axis can go in both directions (None: without a limit), and what is at its soft limit there."""

    low: float | None = None
    high: float | None = None
    low_by: str = ""
    high_by: str = ""

    def narrow(self, low: float, high: float, name: str) -> "_Reach":
        """The range within both."""
        low, high = min(low, 0.0), max(high, 0.0)
        reach = self
        if self.low is None or low > self.low:
            reach = reach._replace(low=low, low_by=name)
        if self.high is None or high < self.high:
            reach = reach._replace(high=high, high_by=name)
        return reach


def find_rates(virtual_map: VirtualMap, positions: Sequence[float]) -> dict[str, list[float]]:
    """The velocity of each real axis per unit/s of a virtual one, the others at rest, by its name in the group.

    positions: of the real axes. A corrected axis is jogged by its own real axis alone: the rates by which the others
    would follow its tables are below the lowest speeds of controllers. Curved groups of several real axes have none: a
    jog would leave their curve. Raises `MapError`.
    """
    names = [split_name(name)[1] for name in virtual_map.virtual]
    if isinstance(virtual_map, CorrectedMap):
        return {name: [float(number == column) for column in range(len(names))] for number, name in enumerate(names)}
    if isinstance(virtual_map, LinearMap):
        return {name: [row[number] for row in virtual_map.inverse_rows] for number, name in enumerate(names)}
    if len(names) > 1:
        return {}
    factor = virtual_map.find_rows(positions)[0][0]
    if not factor:
        raise MapError(f"{virtual_map.label}: its derivative is 0 at {positions[0]:g}")
    return {names[0]: [1.0 / factor]}


def find_jogs(
    virtual_map: VirtualMap, axes: Mapping[str, VirtualAxis], reals: Sequence[RealJog], apart_s: float
) -> dict[str, VirtualJog]:
    """How the virtual axes of a group are jogged, by their names in the group. axes: their configurations. apart_s: by
    how much the instants may differ at which their controllers take one request. Raises `MapError`."""
    positions = [real.state.position for real in reals]
    rates = find_rates(virtual_map, positions)
    if not rates:
        return {}
    targets = virtual_map.observe([real.state.commanded for real in reals])
    group = split_name(virtual_map.virtual[0])[0]
    errors = _find_errors(virtual_map, rates, reals)
    jogs: dict[str, VirtualJog] = {}
    for number, (name, target) in enumerate(zip(rates, targets, strict=True)):
        reach = _find_reach(axes[name], f"{group}.{name}", target)
        if len(reals) > 1:  # one alone ends at its soft limit by itself
            reach = _narrow_by_reals(reach, rates[name], reals)
        sweeps = virtual_map.sweeps[number] if isinstance(virtual_map, LinearMap) else (0.0,)
        off_axes = {key: (sweep, errors[key]) for key, sweep in zip(rates, sweeps, strict=True) if key != name}
        jogs[name] = _make_jog(axes, name, _Motion(rates[name], reals, off_axes, apart_s), reach)
        if isinstance(virtual_map, CorrectedMap):
            jogs[name] = jogs[name].model_copy(update={"lacks_tables": True})
    return jogs


class _Errors(NamedTuple):
    """Of a virtual axis: how fast it may drift because speeds are rounded, in its unit/s, and how far it may be off,
    because drives of its real axes have play, or errors that a jog does not follow, in its unit."""

    rounding: float
    play: float


def _find_errors(virtual_map: VirtualMap, names: Iterable[str], reals: Sequence[RealJog]) -> dict[str, _Errors]:
    """By virtual axis. A real axis alone moves no other virtual one."""
    if len(reals) == 1:
        return {name: _Errors(0.0, 0.0) for name in names}
    if isinstance(virtual_map, CorrectedMap):
        return {name: _Errors(0.0, span) for name, span in zip(names, virtual_map.spans, strict=True)}
    roundings = [abs(real.config.to_length(ROUNDED_COUNTS_S)) for real in reals]
    plays = [_find_play(real.config) for real in reals]
    rows = virtual_map.find_rows([])
    return {
        name: _Errors(*(sum(map(_multiply_sizes, row, lengths)) for lengths in (roundings, plays)))
        for name, row in zip(names, rows, strict=True)
    }


def _find_play(axis: Axis) -> float:
    """How far an axis may be from where its motor has it in a jog, in its unit."""
    width = 0.0 if axis.play is None else abs(axis.to_length(axis.play.most - axis.play.least))
    return width if axis.correction is None else width + axis.correction.table.span


def _multiply_sizes(first: float, second: float) -> float:
    return abs(first) * second


class _Motion(NamedTuple):
    """A jog by `rates` of real axes. others: by the other virtual axes of the group, how far the parts of the real axes
    alone would move it, per unit, and what adds to that. apart_s: as of `find_jogs`."""

    rates: list[float]
    reals: Sequence[RealJog]
    others: Mapping[str, tuple[float, _Errors]]
    apart_s: float


def _make_jog(axes: Mapping[str, VirtualAxis], name: str, motion: _Motion, reach: _Reach) -> VirtualJog:
    lag_s = STEP_S / 2 + motion.apart_s
    deviations = {key: limit for key in motion.others if (limit := axes[key].jog.deviation) is not None}
    moving_axes = [(abs(rate), real) for rate, real in zip(motion.rates, motion.reals, strict=True) if rate]
    speeds = [real.config.jog_speed(referenced=real.state.referenced) / rate for rate, real in moving_axes]
    for key, limit in deviations.items():
        sweep, errors = motion.others[key]
        if sweep:  # the other half of a deviation is left to changes of speed and to the drift
            speeds.append(max(limit - errors.play, 0.0) / (lag_s * sweep) / 2)
    speed = min([*speeds, axes[name].jog.speed or math.inf])
    off_axes = motion.others.items()
    return VirtualJog(
        rates=motion.rates,
        speed=speed,
        acceleration=min(real.config.limits.acceleration / rate for rate, real in moving_axes),
        off={key: lag_s * sweep * speed for key, (sweep, _) in off_axes},
        play={key: errors.play for key, (_, errors) in off_axes if errors.play},
        drift={key: errors.rounding + CRYSTAL_PPM * 1e-6 * speed * sweep for key, (sweep, errors) in off_axes},
        deviations=deviations,
        **reach._asdict(),
    )


def _find_reach(axis: VirtualAxis, name: str, target: float) -> _Reach:
    limits = axis.soft_limits
    if limits is None:
        return _Reach()
    low, high = limits.in_unit(axis.unit)
    return _Reach().narrow(float(low) - target, float(high) - target, name)


def _narrow_by_reals(reach: _Reach, rates: Sequence[float], reals: Sequence[RealJog]) -> _Reach:
    """Within the soft limits and the rooms of the real axes, which are motor positions; of those that have a
    reference."""
    for rate, real in zip(rates, reals, strict=True):
        if not rate or not real.state.referenced:
            continue
        motor, limits = real.state.commanded - float(real.state.offset), real.config.soft_limits
        if limits is not None:
            low, high = limits.in_unit(real.config.unit)
            reach = _narrow_by_span(reach, (float(low) - motor, float(high) - motor), rate, real.name)
        if real.room is not None:
            low, high = real.room
            reach = _narrow_by_span(reach, (low - motor, high - motor), rate, f"{real.name} among zones")
    return reach


def _narrow_by_span(reach: _Reach, span: tuple[float, float], rate: float, name: str) -> _Reach:
    """Within a span of ways of a real axis; nowhere if that is empty."""
    if span[0] > span[1]:
        return reach.narrow(0.0, 0.0, name)
    ends = sorted(end / rate for end in span)
    return reach.narrow(ends[0], ends[1], name)
