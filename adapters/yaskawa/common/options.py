"""The `options:` of a controller of this dialect in the fleet file."""

import math
from typing import Annotated

from pydantic import Field

from adapters.yaskawa.common.ticks import SAMPLES_PER_S
from orchestrator.clock.base import NS_PER_S, NS_PER_US
from orchestrator.model.base import Id, Model

Microseconds = Annotated[int, Field(ge=0, le=1_000_000)]


class YaskawaOptions(Model):
    """Options of an SMC-4000. Times are the firmware's own; the manual gives only "about 0.5 ms" per command
    (L1626)."""

    timeout_s: float = Field(default=1.0, gt=0, le=60, description="Timeout of a reply, s; a later reply is a fault.")
    replace_program: bool = Field(
        default=True, description="Replace another program in the controller, when none is running."
    )
    servo_period_us: int = Field(
        default=1000, ge=250, le=20000, description="TM as configured in the controller; 1000 means 1/1024 s (L10619)."
    )
    decode_us: Microseconds = Field(
        default=500, description="Longest time from a command's last character to its effect, µs."
    )
    decode_min_us: Microseconds = Field(
        default=250,
        description="Shortest time from a command's last character to its effect, µs: a reading of the counter is no "
        "older than this.",
    )
    begin_max_us: Microseconds = Field(
        default=1500, description="Longest time from the sample that ends the wait to BG's effect, µs."
    )
    input_fall_us: Microseconds = Field(
        default=500, description="Longest time from an input's terminal going low to the firmware, µs (L407-411)."
    )
    input_rise_us: Microseconds = Field(default=1500, description="The same for going high, µs.")
    output_on_us: Microseconds = Field(
        default=250, description="Longest time from the firmware to an output's terminal switching on, µs (L482-483)."
    )
    output_off_us: Microseconds = Field(default=500, description="The same for switching off, µs.")
    round_trip_us: Microseconds = Field(
        default=4000, description="Largest network time of one exchange, µs; for the declared costs."
    )
    array_elements: int = Field(
        default=15000,
        ge=100,
        le=15000,
        description="Elements of the controller's arrays that contours may use (L15876).",
    )
    contour_sag_counts: float = Field(
        default=10.0,
        ge=0,
        description="Largest deviation from its plan, between records, of a contour that is too long for the "
        "shortest records, counts.",
    )
    watchdog_s: float = Field(
        default=1.0,
        ge=0.25,
        le=60,
        description="The controller itself stops a move when the adapter has not extended its watchdog deadline for "
        "this long, s.",
    )
    motor_type: dict[Id, float] = Field(
        default={},
        description="By axis, the motor type (MT) that the controller must be set to: 1, -1, 2, -2, 2.5, -2.5.",
    )

    def begin_ticks(self, tick_ns: float, *, interleaved: bool = False) -> tuple[int, int]:
        """Return the earliest and latest number of samples after XT0 at which moves begin: BG or CD takes effect some
        time after it, at a whole sample.

        interleaved: a command of another thread may come first.
        """
        latest_us = self.begin_max_us + (self.interleaved_us if interleaved else 0)
        first = math.floor(self.decode_min_us * NS_PER_US / tick_ns) + 1
        return first, max(first, math.floor(latest_us * NS_PER_US / tick_ns) + 1)

    @property
    def tick_ns(self) -> float:
        """The sample period as configured in the controller."""
        return self.servo_period_us / 1000 / SAMPLES_PER_S * NS_PER_S

    @property
    def interleaved_us(self) -> int:
        """The longest duration of a command of another thread, µs: expressions may double it (L1626)."""
        return 2 * self.decode_us

    @property
    def exchange_ns(self) -> int:
        """The longest duration of one command and its reply, ns."""
        return (self.decode_us + self.round_trip_us) * NS_PER_US
