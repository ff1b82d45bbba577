"""Options of the pp-electronic SMC in the fleet file."""

from typing import Literal

from pydantic import Field

from adapters.toolkit.firing import FiringOptions, Microseconds
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.inferred import InferredClock
from orchestrator.clock.latency import StartLatency
from orchestrator.model.base import Id


class PpSmcOptions(FiringOptions):
    """Properties that the manual leaves open, and measured values. Times of the start are guaranteed bounds."""

    io_port: bool = Field(default=False, description="The i/o port option (8 inputs, 8 outputs) is installed.")
    loop: dict[Id, Literal["open", "closed"]] = Field(
        default={}, description="Loop mode by axis (command ecl). An omitted axis keeps the controller's setting."
    )
    encoders: list[Id] = Field(
        default=[], description="Axes whose encoder is read as actual position; axes in closed loop are always read."
    )
    panel: Literal["lock", "leave"] = Field(
        default="lock", description="lock: the touch screen is switched to REMOTE, so that axes cannot be moved there."
    )
    check_gear: bool = Field(
        default=True, description="gnum / gden must match `scale`, where the axis unit is one of length or angle."
    )
    check_profile: bool = Field(
        default=True,
        description="Speeds are read back from ?conf when arming; off for controllers that list them otherwise.",
    )
    answer_ms: int = Field(default=1000, ge=20, le=60_000, description="Longest time of a reply beyond decoding.")
    rate_ppm: float = Field(
        default=0.0,
        ge=-10_000,
        le=10_000,
        description="How much faster the controller's crystal is than the host's, measured; deviations are learned "
        "from moves.",
    )
    clock_ppm: float = Field(
        default=100.0, ge=0, le=10_000, description="Largest error of the crystal beyond rate_ppm."
    )
    wire_jitter_us: Microseconds = Field(
        default=1000, description="Largest transmission delay of the starting command beyond its characters."
    )
    decode_us: Microseconds = Field(default=12_500, description="Usual time of the firmware for a command.")
    decode_spread_us: Microseconds = Field(default=7_500, description="That time is decode_us plus or minus this.")
    start_skew_us: Microseconds = Field(
        default=100, description="Largest time between the starts of axes in one group."
    )
    input_scan_us: Microseconds = Field(
        default=10_000, description="Longest time until a waiting program detects its input (i/o port option)."
    )
    line_start_us: Microseconds = Field(
        default=1000, description="Longest time from a program line's input or output job to its motion."
    )
    busy_wait_s: float = Field(
        default=30.0,
        ge=0,
        le=3600,
        description="How long connecting waits for the end of a motion or program in progress.",
    )

    def unread_clock(self) -> InferredClock:
        """Return the assumptions about the controller's crystal, and about the time from the end of a starting command
        to the motion."""
        quick_ns, slow_ns = self.decode_ns
        most_ns = slow_ns + (self.start_skew_us + self.wire_jitter_us) * NS_PER_US
        return InferredClock(self.rate_ppm, self.clock_ppm, StartLatency(self.decode_us * NS_PER_US, quick_ns, most_ns))

    @property
    def decode_ns(self) -> tuple[int, int]:
        """Return the shortest and longest execution time of a command, ns."""
        return max(0, self.decode_us - self.decode_spread_us) * 1000, (self.decode_us + self.decode_spread_us) * 1000
