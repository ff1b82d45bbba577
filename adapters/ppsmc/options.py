"""Options of the pp-electronic SMC in the fleet file."""

from typing import Literal

from pydantic import Field

from adapters.toolkit.firing import FiringOptions, Micro
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.inferred import UnreadClock
from orchestrator.clock.latency import Latency
from orchestrator.model.base import Id


class Options(FiringOptions):
    """What the manual leaves open, and what a person has measured. Times of the start are guaranteed bounds."""

    io_port: bool = Field(default=False, description="The i/o port option (8 inputs, 8 outputs) is installed.")
    loop: dict[Id, Literal["open", "closed"]] = Field(
        default={}, description="Loop mode by axis (command ecl). An axis left out keeps what the unit has."
    )
    encoders: list[Id] = Field(
        default=[], description="Axes whose encoder is read as actual position; those in closed loop always are."
    )
    panel: Literal["lock", "leave"] = Field(
        default="lock", description="lock: the touch screen is switched to REMOTE, so that nobody moves axes there."
    )
    check_gear: bool = Field(
        default=True, description="gnum / gden must fit `scale`, where the unit is one of length or angle."
    )
    check_profile: bool = Field(
        default=True, description="Speeds are read back from ?conf when arming; off for units that list them otherwise."
    )
    answer_ms: int = Field(default=1000, ge=20, le=60_000, description="How long an answer may take beyond decoding.")
    rate_ppm: float = Field(
        default=0.0,
        ge=-10_000,
        le=10_000,
        description="How much faster the unit's crystal is than the host's, measured; learned from moves beyond that.",
    )
    clock_ppm: float = Field(default=100.0, ge=0, le=10_000, description="Largest error of the crystal beside that.")
    wire_jitter_us: Micro = Field(
        default=1000, description="Longest way of the starting line to the unit beyond its characters."
    )
    decode_us: Micro = Field(default=12_500, description="Usual time of the firmware for a command.")
    decode_spread_us: Micro = Field(default=7_500, description="That time is decode_us plus or minus this.")
    start_skew_us: Micro = Field(default=100, description="How far the starts of axes in one group lie apart at most.")
    input_scan_us: Micro = Field(
        default=10_000, description="Longest time until a waiting program sees its input (i/o port option)."
    )
    line_start_us: Micro = Field(
        default=1000, description="How long after its input or output job a program line moves at the most."
    )
    busy_wait_s: float = Field(
        default=30.0, ge=0, le=3600, description="How long connecting waits for a motion or program that it has found."
    )

    def unread_clock(self) -> UnreadClock:
        """What is assumed of the unit's crystal, and of the time from the end of a starting line to the motion."""
        quick_ns, slow_ns = self.decode_ns
        most_ns = slow_ns + (self.start_skew_us + self.wire_jitter_us) * NS_PER_US
        return UnreadClock(self.rate_ppm, self.clock_ppm, Latency(self.decode_us * NS_PER_US, quick_ns, most_ns))

    @property
    def decode_ns(self) -> tuple[int, int]:
        """Quickest and slowest execution of a command, ns."""
        return max(0, self.decode_us - self.decode_spread_us) * 1000, (self.decode_us + self.decode_spread_us) * 1000
