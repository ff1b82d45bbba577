"""The `options:` of an SMC-2000 in the fleet file."""

from pydantic import Field

from adapters.yaskawa.common.options import Microseconds, YaskawaOptions


class Smc2000DriverOptions(YaskawaOptions):
    """Options of an SMC-2000. The manual gives only "about 0.5 ms" for a command (L1000)."""

    timeout_s: float = Field(
        default=0.12, gt=0, le=60, description="Longest silence before or within a reply, s; a longer one is a fault."
    )
    hold_us: Microseconds = Field(
        default=16_000, description="Longest time for which a USB serial adapter buffers received bytes, µs."
    )
    round_trip_us: Microseconds = Field(
        default=4000, description="Largest time that operating system and event loop add to one exchange, µs."
    )
    baud_tolerance: float = Field(
        default=0.005, ge=0, le=0.05, description="Largest relative deviation between the baud rates of both sides."
    )
    watchdog_s: float = Field(
        default=1.5,
        ge=0.25,
        le=60,
        description="The controller itself stops a move when the adapter has not extended its watchdog deadline for "
        "this long, s; on a chain of more than three controllers, longer in proportion to their number.",
    )
    array_elements: int = Field(
        default=8000, ge=100, le=8000, description="Elements of the controller's arrays that contours may use (L8261)."
    )
    contour_upload_s: float = Field(
        default=60.0,
        gt=0,
        le=600,
        description="Longest time for loading a jerk-limited move before it is armed, s.",
    )
