"""Options of a make with text lines in the fleet file."""

from pydantic import Field

from adapters.toolkit.firing import FiringOptions, Microseconds


class LineOptions(FiringOptions):
    """Times of the controller. Those of the start are guaranteed bounds in the step's budget."""

    answer_ms: int = Field(default=500, ge=20, le=60_000, description="Longest time of a reply.")
    decode_us: Microseconds = Field(
        default=0, description="Shortest time from the last byte of the start command to the start."
    )
    decode_spread_us: Microseconds = Field(default=3000, description="That time is up to this much longer.")
    wire_jitter_us: Microseconds = Field(
        default=1000, description="Largest transmission delay of the start command beyond its characters."
    )
    clock_ppm: float = Field(default=150.0, ge=0, le=50_000, description="Largest error of the controller's crystal.")
    end_spread_us: Microseconds = Field(
        default=500, description="Largest deviation of a move's duration from its trapezoid, beyond the crystal's."
    )
