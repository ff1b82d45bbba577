"""How one drive is built, wired and set, and what its maker is free to choose."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Micros = Annotated[int, Field(ge=0, le=100_000)]
InputNumber = Annotated[int, Field(ge=1, le=8)]


class Options(BaseModel):
    """Options of one drive. Positions are in the user's units of the drive, from where it stood when it was built."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] = 1_000_000
    """Set by switches on the drive. One that differs from the bus's hears nothing, and destroys what it sends."""
    objects: dict[str, int] = {}
    """What a commissioning tool has stored in the drive: values by `index` or `index:sub`, hexadecimal: `6091:1`."""
    without: tuple[str, ...] = ()
    """Optional objects that it does not have, hexadecimal: `1013`."""
    modes: tuple[Literal[1, 3, 6, 7, 8], ...] = (1, 3, 6, 7, 8)
    """Modes of operation that it has; object 0x6502 says so."""
    serial: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)] = 1
    """0x1018:4."""
    boot_ms: Annotated[int, Field(ge=0, le=60_000)] = 200
    """From power-up, or NMT reset node, to the boot-up message."""

    cycle_us: Annotated[int, Field(ge=1, le=10_000)] = 100
    """Of the drive's control loop, which runs on its own crystal: what moves begins to do so in one of its ticks."""
    real_time_us: Micros = 15
    """Firmware's time for a PDO, SYNC or NMT message."""
    real_time_spread_us: Micros = 10
    """Up to so much more, at random."""
    event_ms: Annotated[int, Field(ge=1, le=1000)] = 1
    """How often event-driven PDOs are looked at while the motor turns."""
    settle_us: Micros = 2000
    """From the last commanded change until the motor is in the position window."""
    sync_missed: Annotated[int, Field(ge=1, le=100)] = 3
    """So many interpolation periods without SYNC are a fault (EMCY 0x8700)."""
    bus_off_ms: Annotated[int, Field(ge=0, le=60_000)] = 500
    """After bus-off the drive's CAN controller is restarted so much later."""
    sdo_timeout_ms: Annotated[int, Field(ge=0, le=60_000)] = 1000
    """A transfer in segments is given up when its client is silent for so long; 0: never."""

    travel: tuple[float, float] | None = None
    """Where the negative and the positive limit switch become active."""
    home_switch: tuple[float | None, float | None] | None = None
    """Between these the home switch is active; null: without an end on this side."""
    index_every: Annotated[float, Field(gt=0)] = 10_000
    """Distance of the encoder's index pulses."""
    home_is_offset: bool = False
    """The home position becomes the home offset (0x607C); else minus it, so that zero lies the offset away from it."""
    enable_input: InputNumber | None = None
    """While this input is low the power stage has no voltage."""


def read_options(options: Mapping[str, object]) -> Options:
    """The options of one drive; `ValueError` (pydantic's) for a wrong one."""
    return Options.model_validate(dict(options))
