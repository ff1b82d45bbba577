"""How one SMC30, or a bus of them, is built, wired and set, and the knobs where the manual leaves a choice."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Millis = Annotated[float, Field(ge=0, le=10_000)]
Seconds = Annotated[float, Field(ge=0, le=60)]
ModuleAddress = Annotated[int, Field(ge=0, le=31)]
Word = Annotated[int, Field(ge=0, le=65_535)]


class UnitOptions(BaseModel):
    """Options of one unit. The numbers of decisions are those of the reference's section 16."""

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
    """What TP answers."""
    travel_steps: tuple[int, int] | None = None
    """Where the CCW and CW end-of-travel inputs become active, steps from the place of the first power-up."""
    modules: dict[ModuleAddress, dict[Annotated[int, Field(ge=0, le=255)], Word]] = {}
    """External modules on the RS485 interface: address to register to content."""
    e2prom_fault: bool = False
    """The permanent memory does not work: M, X, I6 and I7 answer E6 (L1560)."""
    drift_ppm: float = 0.0
    """Error of the unit's crystal, where the fleet does not give one."""
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
    """Decision 15: how long a user input must hold a level to be seen."""
    input_poll_ms: Millis = 0.0
    """Decision 15: how often the firmware looks at the user inputs; 0: always."""
    home_input: Literal["eot", "input3_low"] = "eot"
    """Decision 19: what H watches."""
    overflow_wraps: bool = False
    """Decision 26: arithmetic wraps modulo 65536 instead of ending the program."""
    save_s: Seconds = 2.0
    """Decision 30: time of M and I6."""
    recall_s: Seconds = 0.2
    """Decision 30: time of X and I7."""
    power_up_e1: bool = False
    """Decision 31: the first string after power-up is answered E1 (L1477-L1497)."""

    @model_validator(mode="after")
    def _consistent(self) -> "UnitOptions":
        if self.travel_steps is not None and self.travel_steps[0] >= self.travel_steps[1]:
            raise ValueError("travel_steps: the CCW end must lie below the CW end")
        return self


class Options(UnitOptions):
    """Options of one unit alone; with `units`, of a bus, where the rest is what the units have in common."""

    units: Annotated[list[UnitOptions], Field(max_length=7)] = []
    """The units of a bus, by place; empty: one unit alone."""
    parity: Literal["stripped", "wire"] = "stripped"
    """What a byte is. stripped: the 7-bit character, 128 and up came with a parity error. wire: bit 7 is odd parity."""
    baud: Literal[110, 150, 300, 600, 1200, 2400, 4800, 9600] = 9600
    """DIP B0-B2; used only for how long a reply occupies the shared line."""

    collisions: Literal["same_address", "any"] = "same_address"
    """Which replies that overlap garble each other: of units with one address only, or of any two."""

    def each(self) -> list[UnitOptions]:
        """The units one by one: what all have in common, and on top what each one states."""
        if not self.units:
            return [self]
        common = {name: getattr(self, name) for name in self.model_fields_set & UnitOptions.model_fields.keys()}
        stated = [{name: getattr(unit, name) for name in unit.model_fields_set} for unit in self.units]
        return [UnitOptions.model_validate({**common, **own}) for own in stated]


_TIMES = ("line_ms", "start_latency_ms", "input_filter_ms", "input_poll_ms", "save_s", "recall_s")


def read_options(options: Mapping[str, object], *, ideal: bool = False) -> Options:
    """The options, checked; `ideal`: the firmware takes no time unless they say so.

    `ValueError` names what is wrong and, for an unknown name, the allowed ones.
    """
    unknown = sorted(set(options) - set(Options.model_fields))
    if unknown:
        raise ValueError(f"unknown option {', '.join(unknown)}; allowed: {', '.join(sorted(Options.model_fields))}")
    timeless = dict.fromkeys(_TIMES, 0.0) if ideal else {}
    return Options.model_validate({**timeless, **options})
