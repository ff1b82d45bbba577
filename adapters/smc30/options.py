"""Options of the SMC30 in the fleet file."""

from typing import Annotated

from pydantic import Field

from adapters.toolkit.firing import FiringOptions, Micro
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.inferred import UnreadClock
from orchestrator.clock.latency import Latency

Milliamps = Annotated[int, Field(ge=0, le=12_000)]


class Options(FiringOptions):
    """How the unit is set, what the manual leaves open, and what a person has measured.

    Times of the start are guaranteed bounds: what the step's budget promises is made of them.
    """

    checksum: bool = Field(default=True, description="DIP switch CHS: every line carries a checksum (L1087).")
    standby_ma: Milliamps = Field(default=1000, description="Standby current of an enabled motor (CS); off is 0.")
    ramp_ma: Milliamps | None = Field(default=None, description="Current on ramps (CR). None: as the unit has it.")
    top_ma: Milliamps | None = Field(default=None, description="Current at top rate (CT). None: as the unit has it.")
    rate_ppm: float = Field(
        default=0.0,
        ge=-10_000,
        le=10_000,
        description="How much too fast the unit's crystal is, measured; corrected, and learned from moves beyond that.",
    )
    clock_ppm: float = Field(default=100.0, ge=0, le=10_000, description="Largest error of the crystal beyond that.")
    answer_ms: int = Field(default=100, ge=10, le=60_000, description="How long an answer may take beyond the wire.")
    hold_us: Micro = Field(default=0, description="How long a USB serial adapter may keep received bytes.")
    wire_jitter_us: Micro = Field(
        default=1000, description="Longest way of a line to the unit beyond its characters (USB frame)."
    )
    decode_us: Micro = Field(default=1000, description="Usual time from the end of a line to its effect.")
    decode_spread_us: Micro = Field(default=1000, description="That time is decode_us plus or minus this.")
    line_us: Micro = Field(default=1000, description="The interpreter's time for one program line.")
    line_spread_us: Micro = Field(default=100, description="That time is line_us plus or minus this.")
    start_us: Micro = Field(default=1000, description="From the start condition of N, as seen, to the motion.")
    start_spread_us: Micro = Field(default=200, description="That time is start_us plus or minus this.")
    input_filter_us: Micro = Field(default=200, description="Longest delay of an input's filter and optocoupler.")
    input_poll_us: Micro = Field(default=1000, description="Longest time between two looks at the inputs.")
    busy_wait_s: float = Field(
        default=30.0, ge=0, le=3600, description="How long configuring waits for a program or motion that it has found."
    )

    def unread_clock(self, lines: int) -> UnreadClock:
        """What is assumed of the unit's crystal, and of the time from the end of a starting line, without the delay of
        its program, to the motion behind so many program lines."""
        usual_us = self.decode_us + lines * self.line_us
        least_us = max(0, self.decode_us - self.decode_spread_us) + lines * (self.line_us - self.line_spread_us)
        most_us = usual_us + self.decode_spread_us + lines * self.line_spread_us + self.wire_jitter_us
        start = Latency(usual_us * NS_PER_US, least_us * NS_PER_US, most_us * NS_PER_US)
        return UnreadClock(self.rate_ppm, self.clock_ppm, start)
