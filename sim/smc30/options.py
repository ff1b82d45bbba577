"""Options of one SMC30, or of a bus: its construction, wiring and settings, and the choices that the manual leaves
open."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Millis = Annotated[float, Field(ge=0, le=10_000)]
Seconds = Annotated[float, Field(ge=0, le=60)]
ModuleAddress = Annotated[int, Field(ge=0, le=31)]
Word = Annotated[int, Field(ge=0, le=65_535)]


class IndexerOptions(BaseModel):
    """Options of one device. The numbers of decisions are those of the reference's section 16."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    address: Annotated[int, Field(ge=0, le=7)] = 0
    """DIP A0-A2: 0 point-to-point, 1-7 multipoint (L889-L943)."""
    checksum: bool = False
    """DIP CHS: a checksum on every string, both ways (L1087, L1569)."""
    rec: bool = False
    """DIP REC: recall and run the permanent program at power-up (L1871-L1873)."""
    type: Literal["SMC30B", "SMC30C"] = "SMC30C"
    """SMC30B takes currents up to 6000 mA only (L2008)."""
    temperature_c: int = 25
    """Reply to TP."""
    travel_steps: tuple[int, int] | None = None
    """Positions where the CCW and CW end-of-travel inputs become active, steps from the position at the first power-up.
    """
    modules: dict[ModuleAddress, dict[Annotated[int, Field(ge=0, le=255)], Word]] = {}
    """External modules on the RS485 interface: address to register to content."""
    e2prom_fault: bool = False
    """The permanent memory does not work: M, X, I6 and I7 answer E6 (L1560)."""
    drift_ppm: float = 0.0
    """Error of the device's crystal, where the fleet does not specify one."""
    wander_ppm: Annotated[float, Field(ge=0)] = 0.0
    """Wander of that crystal, ppm/sqrt(s)."""

    direct_moves: bool = True
    """Decision 1: motor commands run in Standby; off: E4 outside a program."""
    live_verify: bool = False
    """Decision 2: V1 and V2 are answered while executing."""
    line_limit: Annotated[int, Field(ge=26, le=1000)] = 80
    """Decision 6: longer strings are answered E1, characters before CR."""
    line_ms: Millis = 1.0
    """Decision 15: the interpreter's time for a program line."""
    start_latency_ms: Millis = 1.0
    """Decision 15: from the start condition of N or NA to the start of the profile."""
    input_filter_ms: Millis = 0.16
    """Decision 15: time for which a user input must keep a level to be seen."""
    input_poll_ms: Millis = 0.0
    """Decision 15: period in which the firmware polls the user inputs; 0: continuously."""
    home_input: Literal["eot", "input3_low"] = "eot"
    """Decision 19: the input that H watches."""
    overflow_wraps: bool = False
    """Decision 26: arithmetic wraps modulo 65536 instead of ending the program."""
    save_s: Seconds = 2.0
    """Decision 30: time of M and I6."""
    recall_s: Seconds = 0.2
    """Decision 30: time of X and I7."""
    power_up_e1: bool = False
    """Decision 31: the first string after power-up is answered E1 (L1477-L1497)."""

    @model_validator(mode="after")
    def _check_consistency(self) -> "IndexerOptions":
        if self.travel_steps is not None and self.travel_steps[0] >= self.travel_steps[1]:
            raise ValueError("travel_steps: the CCW end must lie below the CW end")
        return self


class Smc30Options(IndexerOptions):
    """Options of a single device; with `units`, of a bus, where the other options are common to all devices."""

    units: Annotated[list[IndexerOptions], Field(max_length=7)] = []
    """The devices of a bus, by place; empty: a single device."""
    parity: Literal["stripped", "wire"] = "stripped"
    """Content of a byte. stripped: the 7-bit character, 128 and up had a parity error. wire: bit 7 is odd parity."""
    baud: Literal[110, 150, 300, 600, 1200, 2400, 4800, 9600] = 9600
    """DIP B0-B2; used only for the time that a reply occupies the shared line."""

    collisions: Literal["same_address", "any"] = "same_address"
    """Which overlapping replies garble each other: only those of devices with one address, or any two."""

    def device_options(self) -> list[IndexerOptions]:
        """Return the options of each device: the common ones, overridden by its own."""
        if not self.units:
            return [self]
        common = {name: getattr(self, name) for name in self.model_fields_set & IndexerOptions.model_fields.keys()}
        own_options = [{name: getattr(unit, name) for name in unit.model_fields_set} for unit in self.units]
        return [IndexerOptions.model_validate({**common, **own}) for own in own_options]


_TIMES = ("line_ms", "start_latency_ms", "input_filter_ms", "input_poll_ms", "save_s", "recall_s")


def read_options(options: Mapping[str, object], *, ideal: bool = False) -> Smc30Options:
    """Validate the options; `ideal`: the firmware takes no time unless they state one.

    `ValueError` states the error and, for an unknown name, the allowed ones.
    """
    unknown = sorted(set(options) - set(Smc30Options.model_fields))
    if unknown:
        raise ValueError(
            f"unknown option {', '.join(unknown)}; allowed: {', '.join(sorted(Smc30Options.model_fields))}"
        )
    timeless = dict.fromkeys(_TIMES, 0.0) if ideal else {}
    return Smc30Options.model_validate({**timeless, **options})
