"""Options of one drive: its construction, wiring and settings, and the choices that are free to the maker."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Micros = Annotated[int, Field(ge=0, le=100_000)]
InputNumber = Annotated[int, Field(ge=1, le=8)]


class DriveOptions(BaseModel):
    """Options of one drive. Positions are in the user's units of the drive, from its position at construction."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] = 1_000_000
    """Set by switches on the drive. A drive whose rate differs from the bus's receives nothing, and destroys the
    frames that it sends."""
    objects: dict[str, int] = {}
    """Values stored in the drive by a commissioning tool, by `index` or `index:sub`, hexadecimal: `6091:1`."""
    without: tuple[str, ...] = ()
    """Optional objects that the drive lacks, hexadecimal: `1013`."""
    eds: str | None = None
    """Path of another EDS file, which describes the objects that clients see, their access and the PDOs; None: the
    simulator's own."""
    modes: tuple[Literal[1, 3, 6, 7, 8], ...] = (1, 3, 6, 7, 8)
    """Modes of operation that the drive has; reported in object 0x6502."""
    serial: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)] = 1
    """0x1018:4."""
    boot_ms: Annotated[int, Field(ge=0, le=60_000)] = 200
    """From power-up, or NMT reset node, to the boot-up message."""

    cycle_us: Annotated[int, Field(ge=1, le=10_000)] = 100
    """Period of the drive's control loop, which runs on its own crystal: motions begin at its ticks."""
    real_time_us: Micros = 15
    """Firmware's time for a PDO, SYNC or NMT message."""
    real_time_spread_us: Micros = 10
    """Uniform random extra time, up to this value."""
    event_ms: Annotated[int, Field(ge=1, le=1000)] = 1
    """Period in which event-driven PDOs are checked while the motor turns."""
    settle_us: Micros = 2000
    """From the last commanded change until the motor is in the position window."""
    quick_stop_hold_us: Micros = 100_000
    """From standstill to the end of a quick stop: how long quick stop active is shown at least."""
    sync_missed: Annotated[int, Field(ge=1, le=100)] = 3
    """Number of interpolation periods without SYNC that cause a fault (EMCY 0x8700)."""
    bus_off_ms: Annotated[int, Field(ge=0, le=60_000)] = 500
    """Time after bus-off at which the drive's CAN controller restarts."""
    sdo_timeout_ms: Annotated[int, Field(ge=0, le=60_000)] = 1000
    """Time of client silence after which a segmented transfer is aborted; 0: never."""

    travel: tuple[float, float] | None = None
    """Positions where the negative and the positive limit switch become active."""
    home_switch: tuple[float | None, float | None] | None = None
    """Range in which the home switch is active; null: without an end on this side."""
    index_every: Annotated[float, Field(gt=0)] = 10_000
    """Distance of the encoder's index pulses."""
    home_is_offset: bool = False
    """The home position becomes the home offset (0x607C); otherwise minus it, so that zero is the offset away from
    it."""
    probe_inputs: Annotated[tuple[InputNumber, ...], Field(max_length=2)] = (1, 2)
    """Inputs that are touch probe 1 and 2."""
    enable_input: InputNumber | None = None
    """While this input is low the power stage has no voltage."""

    @property
    def hidden_indices(self) -> frozenset[int]:
        """Return the indices of `without`."""
        return frozenset(int(index, 16) for index in self.without)


def read_options(options: Mapping[str, object]) -> DriveOptions:
    """Validate the options of one drive; `ValueError` (pydantic's) for a wrong one."""
    return DriveOptions.model_validate(dict(options))
