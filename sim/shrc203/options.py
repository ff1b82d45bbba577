"""Options of one SHRC-203: its construction, wiring and settings, and the choices that the manual leaves open."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

AxisNumber = Literal[1, 2, 3]
AxisKey = Literal["1", "2", "3"]
Config = Literal["off", "ok", "error", "missing"]
Speed = Annotated[int, Field(ge=1, le=1_000_000)]
BaseRate = Annotated[int, Field(ge=1, le=1_000_000)]
RampMs = Annotated[int, Field(ge=1, le=1000)]

_COARSE = (1, 2, 3, 4, 5, 6, 8, 10, 12, 20, 25, 30, 40, 50, 60, 80, 100, 120, 125, 200, 250, 300, 400, 600, 800)
DIVISIONS = frozenset((*_COARSE, 1000, 2000, 4000, 8000))
"""Divisions that the motor drivers support (L2548-L2552)."""


class Shrc203Options(BaseModel):
    """Options of one simulated SHRC-203. Unknown ones are refused.

    The first group describes the controller and its stages; the second chooses between readings of the manual.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    controllable: list[AxisNumber] = [1, 2, 3]
    """Controllable axes: memory switch GENERAL-AXIS (L2206-L2222)."""
    base_rate: BaseRate | dict[AxisKey, BaseRate] = 200
    """Memory switch AXIS-BASE RATE of all axes, or by axis (others: 200); one pulse is BASE RATE x 10 / DIVIDE nm
    (L807-L811)."""
    divide: int = 2000
    """Memory switch MOTOR DRIVER-DIVIDE of all axes (L2520)."""
    deg_per_pulse: dict[AxisKey, Annotated[float, Field(gt=0)]] = {}
    """Rotary stages: degrees per pulse, the factor of unit letter D."""
    scales: bool = False
    """Linear scales fitted on all axes; closed loop and T:E need them."""
    scale_resolution_nm: Annotated[int, Field(ge=1)] = 1
    axis_names: Annotated[list[Annotated[str, Field(pattern=r"^[1-9A-Z]$")]], Field(min_length=3, max_length=3)] = [
        "1",
        "2",
        "3",
    ]
    config: Annotated[list[Config], Field(min_length=3, max_length=3)] = ["off", "off", "off"]
    """Memory switches CONFIG1-3 and the stage found on the connector (L1813-L1854)."""
    speed: tuple[Speed, Speed, RampMs] = (100, 1000, 100)
    """S, F (pls/s), R (ms) of every axis and speed number in memory switch SPEED."""
    origin_speed: tuple[Speed, Speed, RampMs] = (100, 1000, 100)
    """S, F (pls/s), R (ms) of every axis in memory switch ORG."""
    origin_pls: dict[AxisKey, int] = {"1": -1000, "2": -1000, "3": -1000}
    """Pulses from the position at first power-up to the mechanical origin."""
    near_pls: Annotated[int, Field(ge=0)] = 0
    """The NEAR sensor is on within this distance of the origin; 0: the stage has none."""
    travel_pls: dict[AxisKey, tuple[int, int]] = {}
    """Limit switches by travel: reverse and forward switch, pulses from the position at first power-up."""
    soft_limit_pls: dict[AxisKey, tuple[int, int]] = {}
    """Memory switch SOFT LIMIT, enabled on these axes: least and greatest coordinate, pulses."""
    serial: str = "2106001001"
    firmware: str = "V2.00.000"

    cr_only_input: bool = False
    """Decision 1: a lone CR ends a line (and LF is ignored)."""
    strict_case: bool = False
    """Decision 3: only upper case is accepted."""
    strict_blanks: bool = False
    """Decision 4: blanks inside a command are errors."""
    line_limit: Annotated[int, Field(ge=16)] = 256
    """Decision 5: longer lines are answered NG, characters."""
    busy_anywhere: bool = False
    """Decision 7: any Busy axis refuses a command, addressed or not."""
    standby_needs_running: bool = False
    """Decision 10: WT/WI on an axis where no double-buffer operation runs are NG."""
    standby_reply_deferred: bool = False
    """Decision 11: WT/WI answer OK_D while a double-buffer operation runs."""
    standby_completion: bool = False
    """Decision 12: a standby sends a completion character too."""
    fixed_decimals: Annotated[int, Field(ge=0, le=9)] | None = None
    """Decision 15: number of decimals in Q:S for units N, U, M, D; zero without a sign."""
    stop_keeps_prebuffer: bool = False
    """Decision 17: the prebuffer survives a stop (the next G runs it)."""
    completion_after_stop: bool = True
    """Decision 17: a prebuffer move stopped by L: still sends its completion character."""
    repeat_executed: bool = False
    """Decision 20: G runs an execution-buffer value again."""
    handover_ms: Annotated[float, Field(ge=0, le=1000)] = 1.0
    """Decision 24: from completion to the start of the migrated operation."""
    settle_ms: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    """Decision 25: closed loop, from the end of the profile to in-position."""
    emergency_excitation_off: bool = True
    """Decision 27: memory switch EMG MT EXCT, the excitation goes off at an emergency stop."""
    arc_unit_required: bool = False
    """Decision 35: a value without unit letter in E and EP is NG."""
    reset_s: Annotated[float, Field(ge=0, le=60)] = 3.0
    """Decision 39: the controller is silent this long after RESET: and power-on by reset."""
    jo_refused: bool = False
    """Decision 40: JO: is unknown instead of the same as JD:."""
    hit_refused: bool = False
    """Decision 46: FMT:HIT is answered NG."""
    overflow_pls: Annotated[int, Field(ge=1)] = 10_000
    """Closed loop: the deviation from the command that is an overflow error S4, pulses."""

    def base_rates(self) -> list[int]:
        """BASE RATE of the axes 1 to 3."""
        rates = self.base_rate
        return [rates.get(key, 200) if isinstance(rates, dict) else rates for key in ("1", "2", "3")]

    @model_validator(mode="after")
    def _check_consistency(self) -> "Shrc203Options":
        if not self.controllable or sorted(set(self.controllable)) != self.controllable:
            raise ValueError("controllable: give one to three different axis numbers, ascending")
        if self.divide not in DIVISIONS:
            raise ValueError(f"divide: must be one of {sorted(DIVISIONS)}")
        for name, speed in (("speed", self.speed), ("origin_speed", self.origin_speed)):
            if speed[0] > speed[1]:
                raise ValueError(f"{name}: S must not exceed F")
        for name, bounds in (("travel_pls", self.travel_pls), ("soft_limit_pls", self.soft_limit_pls)):
            if any(low >= high for low, high in bounds.values()):
                raise ValueError(f"{name}: the reverse limit must lie below the forward one")
        return self


def read_options(options: Mapping[str, object]) -> Shrc203Options:
    """Validate the options. `ValueError` states the error and, for an unknown name, the allowed ones."""
    unknown = sorted(set(options) - set(Shrc203Options.model_fields))
    if unknown:
        raise ValueError(
            f"unknown option {', '.join(unknown)}; allowed: {', '.join(sorted(Shrc203Options.model_fields))}"
        )
    return Shrc203Options.model_validate(dict(options))
