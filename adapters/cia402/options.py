"""Options of a CiA 402 drive in the fleet file."""

from fractions import Fraction

from pydantic import Field

from adapters.toolkit.firing import FiringOptions, Microseconds
from orchestrator.model.base import Rational


class Cia402Options(FiringOptions):
    """Properties that the standards leave open, and measured values.

    Times of the start are guaranteed bounds: the guarantees of the step's budget are computed from them.
    """

    eds: str | None = Field(
        default=None,
        description="The drive's EDS file: compared with the drive, and with the requirements of the adapter.",
    )
    velocity_units: Rational = Field(
        default=Fraction(1), description="Units of 6081h and 6099h that make one count per second."
    )
    acceleration_units: Rational = Field(
        default=Fraction(1), description="Units of 6083h, 6084h, 6085h and 609Ah that make one count per second²."
    )
    encoder: Rational | None = Field(
        default=None, description="Required encoder increments per motor revolution (608Fh). None: not compared."
    )
    gear: Rational | None = Field(
        default=None, description="Required motor per shaft revolutions (6091h). None: not compared."
    )
    feed: Rational | None = Field(
        default=None, description="Required counts per shaft revolution (6092h). None: not compared."
    )
    quick_stop_acceleration: float | None = Field(
        default=None,
        gt=0,
        description="Deceleration of an abort, axis unit/s² (6085h). None: keep the drive's setting.",
    )
    probe_inputs: tuple[int, ...] = Field(
        default=(1, 2),
        max_length=2,
        description="Numbers of the inputs that are the drive's touch probe 1 and 2, by its manual.",
    )
    heartbeat_ms: int = Field(default=100, ge=10, le=5000, description="Period of the drive's heartbeat.")
    state_ms: int = Field(
        default=50, ge=5, le=5000, description="Longest period of the drive's unsolicited state messages."
    )
    inhibit_ms: int = Field(
        default=10, ge=1, le=1000, description="Shortest time between two of its position messages."
    )
    rest_window: int = Field(
        default=10,
        ge=0,
        le=1_000_000,
        description="Of a drive without 6062h: how far its actual position may be from the commanded one at rest, "
        "counts.",
    )
    period_ms: int = Field(
        default=10, ge=1, le=100, description="Period of SYNC while positions are streamed, for jerk-limited motion."
    )
    watchdog_ms: int | None = Field(
        default=None,
        ge=100,
        le=60_000,
        description="The drive makes a quick stop when it has received no heartbeat of this computer for this long "
        "(1016h, 6007h). None: no monitoring.",
    )
    host_node: int = Field(default=127, ge=1, le=127, description="The node number of this computer's heartbeat.")
    answer_ms: int = Field(default=100, ge=10, le=60_000, description="Timeout of an SDO answer.")
    boot_ms: int = Field(default=1000, ge=0, le=60_000, description="Time after power-up without answers.")
    clock_ppm: float = Field(default=100.0, ge=0, le=10_000, description="Largest error of the drive's crystal.")
    wire_jitter_us: Microseconds = Field(
        default=1200,
        description="Largest transmission delay of the SYNC to the bus beyond its own time (operating system, USB).",
    )
    cycle_us: Microseconds = Field(
        default=1000, description="The drive's cycle: longest time from receiving a SYNC to processing it."
    )
    start_us: Microseconds = Field(default=500, description="Usual time from the processed SYNC to the motion.")
    start_spread_us: Microseconds = Field(default=500, description="That time is start_us plus or minus this.")
    output_us: Microseconds = Field(
        default=1000,
        description="Longest time from the processed SYNC to the edge at the terminal of an output (triggers).",
    )
    busy_wait_s: float = Field(
        default=30.0, ge=0, le=3600, description="How long configuring waits for the end of a motion in progress."
    )
