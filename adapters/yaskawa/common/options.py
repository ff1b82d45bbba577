"""What `options:` of a controller may say in the fleet file, for controllers of this dialect."""

import math
from typing import Annotated

from pydantic import Field

from adapters.yaskawa.common.ticks import SAMPLES_PER_S
from orchestrator.clock.base import NS_PER_S, NS_PER_US
from orchestrator.model.base import Id, Model

Microseconds = Annotated[int, Field(ge=0, le=1_000_000)]


class Options(Model):
    """Options of an SMC-4000. Times are the firmware's own; the manual gives only "about 0.5 ms" a command (L1626)."""

    timeout_s: float = Field(default=1.0, gt=0, le=60, description="A reply that takes longer is a fault, s.")
    replace_program: bool = Field(
        default=True, description="Replace another program in the controller, when none is running."
    )
    servo_period_us: int = Field(
        default=1000, ge=250, le=20000, description="TM as the unit is set up; 1000 means 1/1024 s (L10619)."
    )
    decode_us: Microseconds = Field(default=500, description="From a command's last character to its effect, µs.")
    decode_min_us: Microseconds = Field(
        default=250, description="The same, at the least, µs: a reading of the counter is no older than this."
    )
    begin_max_us: Microseconds = Field(
        default=1500, description="From the sample that ends the wait to BG's effect, at the most, µs."
    )
    input_fall_us: Microseconds = Field(
        default=500, description="From an input's terminal going low to the firmware, at the most, µs (L407-411)."
    )
    input_rise_us: Microseconds = Field(default=1500, description="The same for going high, µs.")
    round_trip_us: Microseconds = Field(
        default=4000, description="What the network adds to one exchange, at the most, µs; for the costs declared."
    )
    array_elements: int = Field(
        default=15000,
        ge=100,
        le=15000,
        description="Elements of the controller's arrays that contours may take (L15876).",
    )
    contour_sag_counts: float = Field(
        default=10.0,
        ge=0,
        description="What a contour that is too long for the shortest records may leave its plan by between longer "
        "ones, counts.",
    )
    watchdog_s: float = Field(
        default=1.0,
        ge=0.25,
        le=60,
        description="A move that the adapter has said nothing of for so long is stopped by the controller itself, s.",
    )
    motor_type: dict[Id, float] = Field(
        default={}, description="By axis, the motor type (MT) that the unit must be set to: 1, -1, 2, -2, 2.5, -2.5."
    )

    def begin_ticks(self, tick_ns: float, beside: bool = False) -> tuple[int, int]:
        """Between how many samples after XT0 moves begin: BG or CD takes effect some time after it, at a whole one.

        beside: a command of another thread may come first.
        """
        latest_us = self.begin_max_us + (self.beside_us if beside else 0)
        first = math.floor(self.decode_min_us * NS_PER_US / tick_ns) + 1
        return first, max(first, math.floor(latest_us * NS_PER_US / tick_ns) + 1)

    @property
    def tick_ns(self) -> float:
        """A sample as the unit is set up."""
        return self.servo_period_us / 1000 / SAMPLES_PER_S * NS_PER_S

    @property
    def beside_us(self) -> int:
        """What a command of another thread takes, at the most, µs: expressions may double it (L1626)."""
        return 2 * self.decode_us

    @property
    def exchange_ns(self) -> int:
        """One command and its reply, at the most, ns."""
        return (self.decode_us + self.round_trip_us) * NS_PER_US
