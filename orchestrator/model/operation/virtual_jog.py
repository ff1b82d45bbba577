"""How virtual axes are jogged: the speeds of their real axes, and how far the others of the group may leave their
position.

The velocity changes by steps that all real axes are sent at once, each small enough for the slowest of them. A step of
its speed by dv takes a real axis at most the period of steps, and comes at an instant of its own. From rest to rest,
with one speed between, a real axis is at most v x (STEP_S / 2 + apart_s) from where the others have it: so each other
virtual axis is off by at most the sum of |m| times that, with m its factor; twice as many changes of speed add as much
again. Beside that controllers round speeds to ROUNDED_COUNTS_S and have crystals of their own, which adds up with time.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from pydantic import Field

from orchestrator.model.base import Id, Model
from orchestrator.model.fleet import Axis
from orchestrator.model.linear_map import LinearMap, MapError
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
    virtual axis of the group may be off its position, in its unit, by a jog from rest to that speed and to rest; drift:
    by how much more per second. deviations: the `jog.deviation` of those that have one. low, high: how far it can go,
    in both directions, until `low_by`, `high_by` is at its soft limit; None: without one. reach: how far one jog goes,
    of a pair; None: to these ends.
    """

    rates: list[float]
    speed: float = Field(ge=0)
    acceleration: float = Field(gt=0)
    off: dict[Id, float]
    drift: dict[Id, float]
    deviations: dict[Id, float]
    low: float | None = None
    high: float | None = None
    low_by: str = ""
    high_by: str = ""
    reach: float | None = Field(default=None, exclude_if=lambda reach: reach is None)


class RealJog(NamedTuple):
    """A real axis of a group, `controller.axis`, with its configuration and its state."""

    name: str
    config: Axis
    state: AxisState


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

    positions: of the real axes. Curved groups of several real axes have none: a jog would leave their curve. Raises
    `MapError`.
    """
    names = [split_name(name)[1] for name in virtual_map.virtual]
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
    rows = virtual_map.find_rows(positions)
    targets = virtual_map.observe([real.state.commanded for real in reals])
    group = split_name(virtual_map.virtual[0])[0]
    jogs: dict[str, VirtualJog] = {}
    for name, target in zip(rates, targets, strict=True):
        reach = _find_reach(axes[name], f"{group}.{name}", target)
        if len(reals) > 1:  # one alone ends at its soft limit by itself
            reach = _narrow_by_reals(reach, rates[name], reals)
        off_rows = {key: row for key, row in zip(rates, rows, strict=True) if key != name}
        jogs[name] = _make_jog(axes, name, _Motion(rates[name], reals, off_rows), reach, apart_s)
    return jogs


def _make_jog(
    axes: Mapping[str, VirtualAxis], name: str, motion: "_Motion", reach: _Reach, apart_s: float
) -> VirtualJog:
    deviations = {key: deviation for key in motion.rows if (deviation := axes[key].jog.deviation) is not None}
    moving_axes, sweeps = motion.moving_axes, motion.find_sweeps()
    offs = {key: (STEP_S / 2 + apart_s) * sweep for key, sweep in sweeps.items()}
    speeds = [real.config.jog_speed(referenced=real.state.referenced) / rate for rate, real in moving_axes]
    # The other half of a deviation is left to changes of speed and to the drift.
    speeds += [deviation / offs[key] / 2 for key, deviation in deviations.items() if offs[key]]
    speed = min([*speeds, axes[name].jog.speed or math.inf])
    rounding = motion.find_rounding()
    return VirtualJog(
        rates=motion.rates,
        speed=speed,
        acceleration=min(real.config.limits.acceleration / rate for rate, real in moving_axes),
        off={key: off * speed for key, off in offs.items()},
        drift={key: rounding[key] + CRYSTAL_PPM * 1e-6 * speed * sweep for key, sweep in sweeps.items()},
        deviations=deviations,
        **reach._asdict(),
    )


class _Motion(NamedTuple):
    """A jog by `rates` of real axes. rows: by the other virtual axes of the group, their factors."""

    rates: list[float]
    reals: Sequence[RealJog]
    rows: Mapping[str, Sequence[float]]

    @property
    def moving_axes(self) -> list[tuple[float, RealJog]]:
        """Those of the real axes that move, with the size of their rates."""
        return [(abs(rate), real) for rate, real in zip(self.rates, self.reals, strict=True) if rate]

    def find_sweeps(self) -> dict[str, float]:
        """How far the parts of the real axes alone would move each other virtual axis, per unit."""
        return {
            name: sum(abs(factor * rate) for factor, rate in zip(row, self.rates, strict=True))
            for name, row in self.rows.items()
        }

    def find_rounding(self) -> dict[str, float]:
        """How fast each other virtual axis may drift because speeds are rounded, in its unit/s."""
        lengths = [
            abs(real.config.to_length(ROUNDED_COUNTS_S)) if rate else 0.0
            for rate, real in zip(self.rates, self.reals, strict=True)
        ]
        return {
            name: sum(abs(factor) * length for factor, length in zip(row, lengths, strict=True))
            for name, row in self.rows.items()
        }


def _find_reach(axis: VirtualAxis, name: str, target: float) -> _Reach:
    limits = axis.soft_limits
    if limits is None:
        return _Reach()
    low, high = limits.in_unit(axis.unit)
    return _Reach().narrow(float(low) - target, float(high) - target, name)


def _narrow_by_reals(reach: _Reach, rates: Sequence[float], reals: Sequence[RealJog]) -> _Reach:
    """Within the soft limits of the real axes, which are motor positions; of those that have a reference."""
    for rate, real in zip(rates, reals, strict=True):
        limits = real.config.soft_limits
        if not rate or limits is None or not real.state.referenced:
            continue
        motor = real.state.commanded - float(real.state.offset)
        ends = sorted((float(end) - motor) / rate for end in limits.in_unit(real.config.unit))
        reach = reach.narrow(ends[0], ends[1], real.name)
    return reach
