"""Options of the SMC30 in the fleet file."""

from typing import Annotated

from pydantic import Field

from adapters.toolkit.firing import FiringOptions, Microseconds
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.inferred import InferredClock
from orchestrator.clock.latency import StartLatency

Milliamps = Annotated[int, Field(ge=0, le=12_000)]


class Smc30DriverOptions(FiringOptions):
    """Settings of the controller, properties that the manual leaves open, and measured values.

    Times of the start are guaranteed bounds: the guarantees of the step's budget are computed from them.
    """

    checksum: bool = Field(default=True, description="DIP switch CHS: every line carries a checksum (L1087).")
    standby_ma: Milliamps = Field(default=1000, description="Standby current of an enabled motor (CS); off is 0.")
    ramp_ma: Milliamps | None = Field(
        default=None, description="Current on ramps (CR). None: keep the controller's setting."
    )
    top_ma: Milliamps | None = Field(
        default=None, description="Current at top rate (CT). None: keep the controller's setting."
    )
    rate_ppm: float = Field(
        default=0.0,
        ge=-10_000,
        le=10_000,
        description="How much too fast the controller's crystal is, measured; corrected, and deviations are learned "
        "from moves.",
    )
    clock_ppm: float = Field(
        default=100.0, ge=0, le=10_000, description="Largest error of the crystal beyond rate_ppm."
    )
    answer_ms: int = Field(
        default=100, ge=10, le=60_000, description="Longest time of a reply beyond its transmission."
    )
    hold_us: Microseconds = Field(
        default=0, description="Longest time for which a USB serial adapter buffers received bytes."
    )
    wire_jitter_us: Microseconds = Field(
        default=1000, description="Largest transmission delay of a command beyond its characters (USB frame)."
    )
    decode_us: Microseconds = Field(default=1000, description="Usual time from the end of a command to its effect.")
    decode_spread_us: Microseconds = Field(default=1000, description="That time is decode_us plus or minus this.")
    line_us: Microseconds = Field(default=1000, description="The interpreter's time for one program line.")
    line_spread_us: Microseconds = Field(default=100, description="That time is line_us plus or minus this.")
    start_us: Microseconds = Field(
        default=1000, description="Usual time from the detection of N's start condition to the motion."
    )
    start_spread_us: Microseconds = Field(default=200, description="That time is start_us plus or minus this.")
    input_filter_us: Microseconds = Field(
        default=200, description="Longest delay of an input's filter and optocoupler."
    )
    input_poll_us: Microseconds = Field(default=1000, description="Longest time between two scans of the inputs.")
    busy_wait_s: float = Field(
        default=30.0,
        ge=0,
        le=3600,
        description="How long configuring waits for the end of a program or motion in progress.",
    )

    def unread_clock(self, lines: int) -> InferredClock:
        """Return the assumptions about the controller's crystal, and about the time from the end of a starting command,
        without the delay of its program, to the motion after `lines` program lines."""
        usual_us = self.decode_us + lines * self.line_us
        least_us = max(0, self.decode_us - self.decode_spread_us) + lines * (self.line_us - self.line_spread_us)
        most_us = usual_us + self.decode_spread_us + lines * self.line_spread_us + self.wire_jitter_us
        start = StartLatency(usual_us * NS_PER_US, least_us * NS_PER_US, most_us * NS_PER_US)
        return InferredClock(self.rate_ppm, self.clock_ppm, start)
