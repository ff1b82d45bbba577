"""Options of the SHRC-203 in the fleet file."""

from typing import Literal

from pydantic import Field

from adapters.toolkit.firing import FiringOptions, Micro
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.inferred import UnreadClock
from orchestrator.clock.latency import Latency


class Options(FiringOptions):
    """What the manual leaves open, and what a person has measured. Times of the start are guaranteed bounds."""

    loop: Literal["open", "closed"] | None = Field(
        default=None, description="Loop mode of all axes (command F:). None: leave it as the unit has it."
    )
    nm_per_pulse: float | None = Field(
        default=None, gt=0, description="What ?:P must read on every axis; None: derived from scale of length axes."
    )
    bridge_baud: int = Field(
        default=38400, gt=0, description="Baud rate behind a TCP serial bridge; serial links have their own."
    )
    answer_ms: int = Field(default=500, ge=20, le=60_000, description="How long an answer may take beyond the wire.")
    cw: Literal["forward", "reverse"] = Field(
        default="forward", description="Which end the CW limit sensor is at; the manual does not say."
    )
    rate_ppm: float = Field(
        default=0.0,
        ge=-10_000,
        le=10_000,
        description="How much faster the unit's crystal is than the host's, measured; learned from moves beyond that.",
    )
    clock_ppm: float = Field(default=100.0, ge=0, le=10_000, description="Largest error of the crystal beside that.")
    wire_jitter_us: Micro = Field(
        default=1000, description="Longest way of the starting line to the unit beyond its characters (USB frame)."
    )
    decode_us: Micro = Field(default=1000, description="Usual time from the end of the starting line to the motion.")
    decode_spread_us: Micro = Field(default=1000, description="That time is decode_us plus or minus this.")
    start_after_ok_us: Micro = Field(
        default=0, description="How long after sending OK to the starting line the motion may begin at the most."
    )
    input_scan_us: Micro = Field(default=1000, description="Longest time until a changed input is seen.")
    line_start_us: Micro = Field(
        default=1000, description="How long after that the motion of a line start may begin at the most."
    )
    handover_us: Micro = Field(
        default=1000, description="How long an axis stands between two moves of which the second was in its prebuffer."
    )
    busy_wait_s: float = Field(
        default=30.0, ge=0, le=3600, description="How long configuring waits for a motion that it has found."
    )

    def unread_clock(self) -> UnreadClock:
        """What is assumed of the unit's crystal, and of the time from the end of a starting line to the motion."""
        least_us = max(0, self.decode_us - self.decode_spread_us)  # nothing is decoded in less than no time
        most_us = self.decode_us + self.decode_spread_us + self.wire_jitter_us
        start = Latency(self.decode_us * NS_PER_US, least_us * NS_PER_US, most_us * NS_PER_US)
        return UnreadClock(self.rate_ppm, self.clock_ppm, start)
