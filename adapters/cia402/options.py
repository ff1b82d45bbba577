"""Options of a CiA 402 drive in the fleet file."""

from fractions import Fraction

from pydantic import Field

from adapters.toolkit.firing import FiringOptions, Micro
from orchestrator.model.base import Rational


class Options(FiringOptions):
    """What the standards leave open, and what a person has measured.

    Times of the start are guaranteed bounds: what the step's budget promises is made of them.
    """

    eds: str | None = Field(
        default=None, description="The drive's EDS file: compared with the drive, and with what the adapter needs."
    )
    velocity_units: Rational = Field(
        default=Fraction(1), description="Units of 6081h and 6099h that make one count per second."
    )
    acceleration_units: Rational = Field(
        default=Fraction(1), description="Units of 6083h, 6084h, 6085h and 609Ah that make one count per second²."
    )
    encoder: Rational | None = Field(
        default=None, description="Encoder increments per motor revolution that 608Fh must hold. None: not compared."
    )
    gear: Rational | None = Field(
        default=None, description="Motor per shaft revolutions that 6091h must hold. None: not compared."
    )
    feed: Rational | None = Field(
        default=None, description="Counts per shaft revolution that 6092h must hold. None: not compared."
    )
    quick_stop_acceleration: float | None = Field(
        default=None, gt=0, description="Deceleration of an abort, axis unit/s² (6085h). None: as the drive has it."
    )
    heartbeat_ms: int = Field(default=100, ge=10, le=5000, description="How often the drive says that it lives.")
    state_ms: int = Field(default=50, ge=5, le=5000, description="How often the drive sends its state unasked.")
    inhibit_ms: int = Field(default=10, ge=1, le=1000, description="Least time between two of its positions.")
    period_ms: int = Field(
        default=10, ge=1, le=100, description="Period of SYNC while positions are streamed, for jerk-limited motion."
    )
    watchdog_ms: int | None = Field(
        default=None,
        ge=100,
        le=60_000,
        description="The drive makes a quick stop when it has heard no heartbeat of this computer for so long (1016h, "
        "6007h). None: it does not watch.",
    )
    host_node: int = Field(default=127, ge=1, le=127, description="The node number of this computer's heartbeat.")
    answer_ms: int = Field(default=100, ge=10, le=60_000, description="How long an SDO answer may take.")
    boot_ms: int = Field(default=1000, ge=0, le=60_000, description="How long after power-up it does not answer yet.")
    clock_ppm: float = Field(default=100.0, ge=0, le=10_000, description="Largest error of the drive's crystal.")
    wire_jitter_us: Micro = Field(
        default=1200, description="Longest way of the SYNC to the bus beyond its own time (operating system, USB)."
    )
    cycle_us: Micro = Field(default=1000, description="The drive's cycle: how long a received SYNC may wait for it.")
    start_us: Micro = Field(default=500, description="Usual time from the SYNC, as taken, to the motion.")
    start_spread_us: Micro = Field(default=500, description="That time is start_us plus or minus this.")
    busy_wait_s: float = Field(
        default=30.0, ge=0, le=3600, description="How long configuring waits for a motion that it has found."
    )
