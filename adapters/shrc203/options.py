"""Options of the SHRC-203 in the fleet file."""

from typing import Literal

from pydantic import Field

from adapters.toolkit.firing import FiringOptions, Microseconds
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.inferred import InferredClock
from orchestrator.clock.latency import StartLatency
from orchestrator.model.messages import BudgetTerm


class ShrcOptions(FiringOptions):
    """Properties that the manual leaves open, and measured values. Times of the start are guaranteed bounds."""

    loop: Literal["open", "closed"] | None = Field(
        default=None, description="Loop mode of all axes (command F:). None: keep the controller's setting."
    )
    nm_per_pulse: float | None = Field(
        default=None,
        gt=0,
        description="Required value of ?:P on every axis; None: derived from the scale of length axes.",
    )
    bridge_baud: int = Field(
        default=38400, gt=0, description="Baud rate behind a TCP serial bridge; serial links have their own."
    )
    answer_ms: int = Field(
        default=500, ge=20, le=60_000, description="Longest time of a reply beyond its transmission."
    )
    cw: Literal["forward", "reverse"] = Field(
        default="forward", description="The end at which the CW limit sensor is; the manual does not state it."
    )
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
        default=1000,
        description="Largest transmission delay of the starting command beyond its characters (USB frame).",
    )
    decode_us: Microseconds = Field(
        default=1000, description="Usual time from the end of the starting command to the motion."
    )
    decode_spread_us: Microseconds = Field(default=1000, description="That time is decode_us plus or minus this.")
    start_after_ok_us: Microseconds = Field(
        default=0, description="Longest time from sending the OK for the starting command to the motion."
    )
    input_scan_us: Microseconds = Field(default=1000, description="Longest time until a changed input is detected.")
    line_start_us: Microseconds = Field(
        default=1000, description="Longest time from that detection to the motion of a start by trigger line."
    )
    handover_us: Microseconds = Field(
        default=1000, description="Pause of an axis between two moves of which the second was in its prebuffer."
    )
    trigger_width_us: Microseconds = Field(
        default=10, description="How long a pulse of the trigger output lasts: memory switch TRG WIDTH."
    )
    trigger_delay_us: Microseconds = Field(
        default=100, description="Longest time from the drive pulse to its pulse of the trigger output."
    )
    busy_wait_s: float = Field(
        default=30.0, ge=0, le=3600, description="How long configuring waits for the end of a motion in progress."
    )

    def unread_clock(self) -> InferredClock:
        """Return the assumptions about the controller's crystal, and about the time from the end of a starting command
        to the motion."""
        least_us = max(0, self.decode_us - self.decode_spread_us)  # a decoding time is never negative
        most_us = self.decode_us + self.decode_spread_us + self.wire_jitter_us
        start = StartLatency(self.decode_us * NS_PER_US, least_us * NS_PER_US, most_us * NS_PER_US)
        return InferredClock(self.rate_ppm, self.clock_ppm, start)


LOWEST_POINT = 1  # the number of the input or output in bit 0 (L5274-L5304, L5327-L5357)


def edge_terms(options: ShrcOptions, lead_ns: int, behind_ns: int) -> tuple[BudgetTerm, ...]:
    """Return the terms of the edge of a driven trigger line relative to T0.

    lead_ns: how long before T0 the first command reaches the controller. behind_ns: transmission time of the switching
    command after the starting command, 0 when it is sent alone. After another command it is decoded once it has arrived
    and that command is done.
    """
    slow_ns = (options.decode_us + options.decode_spread_us) * NS_PER_US
    quick_ns = max(0, options.decode_us - options.decode_spread_us) * NS_PER_US
    if behind_ns:
        slow_ns += max(behind_ns, slow_ns)
        quick_ns += max(behind_ns, quick_ns)
    return (
        options.host_term(),
        BudgetTerm(name="wire", earliest_ns=0, latest_ns=options.wire_jitter_us * NS_PER_US),
        BudgetTerm(name="firmware", earliest_ns=quick_ns - lead_ns, latest_ns=slow_ns - lead_ns),
    )
