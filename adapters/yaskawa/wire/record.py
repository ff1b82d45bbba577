"""The binary data record (QR): state of inputs, outputs and all axes, stamped with the sample in which it was taken.

Sizes come from QZ, because firmware versions differ in them (L8983-9104); positions within a block are the manual's
(L8697-8919) with the item sizes of section L8969-8973. Little endian.
"""

import struct
from dataclasses import dataclass
from typing import NamedTuple

from adapters.yaskawa.language.numbers import parse_sizes
from orchestrator.model.errors import ControllerFault

AXIS_LETTERS = "XYZWEFGH"  # the SMC-4000 has the first four, an SMC-2000 up to eight
RECORD_LETTERS = "ABCD"  # the first four, as QR names them

_GENERAL = "H10s10sBB"  # sample number, inputs, outputs, error code, general status
_AXIS = "HBBiiiiih"  # status, switches, stop code, reference, motor, error, auxiliary, velocity, torque
_GENERAL_BYTES = struct.calcsize("<" + _GENERAL)
_AXIS_BYTES = struct.calcsize("<" + _AXIS)
_AXIS_FIELDS = 9
VELOCITY_SCALE = 64.0  # the record's velocity is 64 times TV

# Axis status (L9017-9076) and switches (L8998-9015)
MOVING = 1 << 15
STOPPING = 1 << 4  # because of ST or a limit
OFF_ON_ERROR = 1 << 1
MOTOR_OFF = 1 << 0
FORWARD_SWITCH = 1 << 3
REVERSE_SWITCH = 1 << 2
PROGRAM_RUNS = 1 << 7


class AxisRecord(NamedTuple):
    """One axis's block. Positions in counts; velocity in counts/s times 64."""

    status: int
    switches: int
    stop_code: int
    commanded: int
    actual: int
    error: int
    auxiliary: int
    velocity: int
    torque: int

    @property
    def is_moving(self) -> bool:
        return bool(self.status & MOVING)

    @property
    def is_stopping(self) -> bool:
        return bool(self.status & STOPPING)

    @property
    def is_enabled(self) -> bool:
        return not self.status & MOTOR_OFF

    @property
    def velocity_counts_s(self) -> float:
        """Its velocity; 0 for an axis that is held at rest: TV is an average over 256 samples (L11017-11038), which
        shows motion after the end of a move. With the motor off it shows what moves the axis by hand."""
        is_held = self.is_enabled and not self.is_moving
        return 0.0 if is_held else self.velocity / VELOCITY_SCALE


class DataRecord(NamedTuple):
    """One data record. inputs, outputs: bit 0 is number 1."""

    sample: int
    inputs: int
    outputs: int
    program_runs: bool
    axes: tuple[AxisRecord, ...]
    sent_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class RecordFormat:
    """The request for this controller's record of all its axes, and its layout."""

    axes: int
    command: str
    header: bytes
    length: int
    layout: struct.Struct

    @classmethod
    def from_sizes(cls, line: str) -> "RecordFormat":
        """Build the format from the reply to QZ: axes, bytes of the general, coordinate and axis blocks."""
        sizes = parse_sizes(line)
        if len(sizes) != 4 or not 1 <= sizes[0] <= 4 or sizes[1] < _GENERAL_BYTES or sizes[3] < _AXIS_BYTES:
            raise ControllerFault(
                "garbage",
                f"after 'QZ' expected axes 1..4 and block sizes of at least {_GENERAL_BYTES}, ., "
                f"{_AXIS_BYTES}, got {line!r}",
                "is this an SMC-4000?",
            )
        axes, general, _, axis = sizes
        mask = 0x8000 | 0x0400 | ((1 << axes) - 1)  # L8921-8966: always set, I block, axes
        blocks = f"{_GENERAL}{general - _GENERAL_BYTES}x", f"{_AXIS}{axis - _AXIS_BYTES}x"
        return cls.from_blocks(axes, blocks, struct.pack("<H", mask))

    def require_axes(self, count: int) -> None:
        """Raise `ControllerFault` for a controller with fewer axes than the fleet file uses."""
        if self.axes < count:
            raise ControllerFault(
                "config-mismatch",
                f"the fleet file uses motor {AXIS_LETTERS[count - 1]}; the controller has {self.axes} axes",
                "correct `motors` in the fleet file, or the address of the controller",
            )

    @classmethod
    def from_blocks(cls, axes: int, blocks: tuple[str, str], mask: bytes) -> "RecordFormat":
        """Build the format from the layouts of the general block (five values, as in `DataRecord`) and of an axis block
        (nine, as in `AxisRecord`). mask: the two bytes of the header that name the blocks."""
        general, axis = blocks
        layout = struct.Struct(f"<4x{general}" + axis * axes)
        header = mask + struct.pack("<H", layout.size)
        return cls(axes, f"QR {RECORD_LETTERS[:axes]}I", header, layout.size, layout)

    def parse_record(self, data: bytes, sent_ns: int, received_ns: int) -> DataRecord:
        values = self.layout.unpack(data)
        axes = tuple(
            AxisRecord(*values[at : at + _AXIS_FIELDS]) for at in range(5, 5 + self.axes * _AXIS_FIELDS, _AXIS_FIELDS)
        )
        return DataRecord(
            sample=values[0],
            inputs=values[1][0],
            outputs=values[2][0],
            program_runs=bool(values[4] & PROGRAM_RUNS),
            axes=axes,
            sent_ns=sent_ns,
            received_ns=received_ns,
        )
