"""Checks of axes of two motors in a controller's part of the fleet file."""

from collections.abc import Iterator

from adapters.yaskawa.common.options import YaskawaOptions
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.fleet import Controller, SerialLink
from orchestrator.model.pairs.rack import STOP_S

STOP_EXCHANGES = 4  # two that a reading may wait for, the reading, and the stop


def find_pair_problems(config: Controller, options: YaskawaOptions) -> Iterator[str]:
    """What such axes cannot have."""
    stop_s = STOP_EXCHANGES * options.exchange_ns / NS_PER_S
    for name, axis in config.axes.items():
        if axis.rack is None:
            continue
        if isinstance(config.link, SerialLink):
            yield f"axes.{name}.motors: on a serial port two motors are not read often enough; use TCP or UDP"
        elif stop_s > STOP_S:
            yield (
                f"options.round_trip_us: with {options.round_trip_us} and decode_us {options.decode_us} a stop of the "
                f"two motors of axis {name} takes {stop_s * 1e3:.0f} ms; at most {STOP_S * 1e3:.0f} fit"
            )
        if axis.homing.method not in ("default", "edge"):
            yield (
                f"axes.{name}.homing.method: {axis.homing.method!r}; an axis of two motors is homed by its two home "
                "switches (edge), because an index pulse would set the count of one motor alone"
            )
        if axis.limits.jerk is not None:
            yield (
                f"axes.{name}.limits.jerk: an axis of two motors moves by trapezoids, because contours are not stated "
                "to move a geared motor; leave it out"
            )
