"""What `options:` of an SMC-2000 may say in the fleet file."""

from pydantic import Field

from adapters.yaskawa.common.options import Microseconds, Options


class Smc2000Options(Options):
    """Options of an SMC-2000. The manual gives "about 0.5 ms" for a command (L1000) and no more."""

    timeout_s: float = Field(
        default=0.12, gt=0, le=60, description="Silence before a reply, or within it, that lasts longer is a fault, s."
    )
    hold_us: Microseconds = Field(
        default=16_000, description="How long a USB serial adapter may keep bytes that it has received, µs."
    )
    round_trip_us: Microseconds = Field(
        default=4000, description="What operating system and event loop add to one exchange, at the most, µs."
    )
    baud_tolerance: float = Field(
        default=0.005, ge=0, le=0.05, description="How far the baud rates of both sides may be off, relative."
    )
    watchdog_s: float = Field(
        default=1.5,
        ge=0.25,
        le=60,
        description="A move that the adapter has said nothing of for so long is stopped by the controller itself, s; "
        "on a chain of more than three, for as much longer as it has more units.",
    )
    array_elements: int = Field(
        default=8000, ge=100, le=8000, description="Elements of the controller's arrays that contours may take (L8261)."
    )
    contour_upload_s: float = Field(
        default=60.0,
        gt=0,
        le=600,
        description="How long loading a jerk-limited move may take before it is armed, s.",
    )
