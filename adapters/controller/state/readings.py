"""What a poll must be before anything uses it, whatever its make's parser let through."""

from math import isfinite

from adapters.contract import ControllerReading
from orchestrator.model.errors import ControllerFault

LARGEST_COUNTS = 2**53  # a larger count is not a whole number in JSON, nor in a float


def require_sound_reading(reading: ControllerReading) -> None:
    """Raise `ControllerFault` for a count or a velocity that no controller can have."""
    for name, axis in reading.axes.items():
        for value_name, value in (
            ("commanded position", axis.commanded_counts),
            ("actual position", axis.actual_counts),
            ("velocity", axis.velocity_counts_s),
        ):
            if not isfinite(value) or abs(value) > LARGEST_COUNTS:
                raise ControllerFault(
                    "garbage",
                    f"axis {name}: the {value_name} {value:g} is not within ±2^53",
                    "check cable and ground; `tutti trace` shows the bytes",
                    name,
                )
