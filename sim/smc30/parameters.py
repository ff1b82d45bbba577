"""Motor parameters R, S, T and the currents (L1989-L2033, L2252-L2288)."""

import math
from dataclasses import dataclass, field
from typing import Literal

from sim.smc30.profile import StepProfile, trapezoid_profile
from sim.smc30.refusal import StatementRefused

Rate = Literal["R", "RT", "RS", "S", "T"]

RANGES: dict[Rate, tuple[int, int]] = {
    "R": (1, 10_000),
    "RT": (1, 1000),
    "RS": (10, 30_000),
    "S": (16, 2000),
    "T": (16, 15_000),
}
"""Steps, 1/100 s, steps/s², steps/s, steps/s (L2260-L2281)."""

_FULL_SCALE = {"R": 1000, "S": 200, "T": 1000}
"""Value at 5.10 V per unit of n2 (decision 28; T with n2 = 4 is stated, L2336-L2347)."""
_FLOOR = 16
_ANALOGUE_TOP = 255


@dataclass(slots=True)
class MotorParameters:
    """Parameters of the next motor command; the ramp is stored in the form in which it was set (decision 12)."""

    start: int = 100
    top: int = 1000
    ramp_form: Literal["R", "RT", "RS"] = "R"
    ramp_value: int = 100
    currents_ma: dict[str, int] = field(default_factory=lambda: {"CS": 1000, "CR": 1000, "CT": 1000})

    def set_rate(self, rate: Rate, value: int) -> None:
        """Set one parameter; E5 outside its range (L1558)."""
        low, high = RANGES[rate]
        if not low <= value <= high:
            raise StatementRefused("E5")
        if rate == "S":
            self.start = value
        elif rate == "T":
            self.top = value
        else:
            self.ramp_form, self.ramp_value = rate, value

    def set_from_analogue(self, rate: Literal["R", "S", "T"], level: int, scale: int) -> None:
        """Execute r, s, t: proportional to the analogue level 0-255, at least 16 (L2289-L2347)."""
        high = RANGES[rate][1]
        full = min(scale * _FULL_SCALE[rate], high)
        self.set_rate(rate, max(_FLOOR, level * full // _ANALOGUE_TOP))

    @property
    def ramp_steps(self) -> int:
        """Ramp in steps, independent of the form that set it (L2355, decision 12)."""
        if self.ramp_form == "R":
            return self.ramp_value
        if self.ramp_form == "RT":
            steps = (self.start + self.top) / 2 * self.ramp_value / 100
        else:
            steps = (self.top**2 - self.start**2) / (2 * self.ramp_value)
        low, high = RANGES["R"]
        return min(max(math.floor(steps + 0.5), low), high)

    @property
    def acceleration(self) -> float:
        """Acceleration, steps/s²; zero when T is not above S."""
        return max(0.0, (self.top**2 - self.start**2) / (2 * self.ramp_steps))

    def move_profile(self, steps: float) -> StepProfile:
        """Build the profile of a move of `steps` with these parameters."""
        return trapezoid_profile(steps, self.start, self.top, self.ramp_steps)
