"""The data records of the two families (QR, QZ), by the structures that Galil publishes (gclib_record.h).

Offsets are from the beginning of the record, which has four bytes of header: the blocks that are present (80h and I, T,
S; then the axes), and its length.
"""

import struct
from dataclasses import dataclass

from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.status import axis_values, report_text
from sim.yaskawa.language.context import CommandContext, CommandDefinition, Outcome, Runner
from sim.yaskawa.language.statements import RawData

_AXES = "ABCD"
_MACHINE_AXES = "XYZW"


@dataclass(frozen=True, slots=True)
class RecordLayout:
    """Sizes of a family's blocks, and where values are in them.

    general, planes, axis: bytes. error: offset of the error code in the general block; the thread byte follows it.
    torque: layout of the torque. threads: the thread byte has a bit for each thread, otherwise bit 7 for any.
    """

    general: int
    planes: int
    axis: int
    error: int
    torque: str
    threads: bool


DMC2103 = RecordLayout(general=24, planes=16, axis=28, error=22, torque="h", threads=False)
"""`GDataRecord2103`: axis A begins at 44."""
DMC4000 = RecordLayout(general=52, planes=26, axis=36, error=46, torque="i", threads=True)
"""`GDataRecord4000`: error code at 50, axis A at 82."""


def make_commands(layout: RecordLayout) -> dict[str, CommandDefinition]:
    """Return QR and QZ of a family."""

    def compile_sizes(text: str) -> Runner:
        if text:
            raise CommandError(4)
        sizes = f"{layout.general}, {layout.planes}, {layout.axis}"
        return lambda c: report_text(c, f"{len(c.machine.letters)}, {sizes}")

    def compile_record(text: str) -> Runner:
        if any(letter not in f"{_AXES}{_MACHINE_AXES}STI" for letter in text):
            raise CommandError(4)
        wanted_axis = {_AXES[_MACHINE_AXES.find(letter)] if letter in _MACHINE_AXES else letter for letter in text}

        def run_command(c: CommandContext) -> Outcome:
            data = _pack_record(c, layout, wanted_axis or {*"IST", *_AXES[: len(c.machine.letters)]})
            if c.port is None:
                c.machine.ports.send_message(data.decode("latin-1"))
                return None
            return RawData(data.decode("latin-1"))

        return run_command

    return {
        "QZ": CommandDefinition(compile_sizes, "both", ""),
        "QR": CommandDefinition(compile_record, "both", ""),
    }


def _pack_record(c: CommandContext, layout: RecordLayout, wanted: set[str]) -> bytes:
    machine, blocks, axes = c.machine, b"", 0
    first = 0x80 | ("I" in wanted) << 2 | ("T" in wanted) << 1 | ("S" in wanted)
    if "I" in wanted:
        blocks += _pack_general(c, layout)
    if {"S", "T"} & wanted:
        # Segments of coordinated moves, which are at rest here.
        blocks += bytes(layout.planes // 2 * len({"S", "T"} & wanted))
    sample_now = machine.current_sample()
    for index, letter in enumerate(_AXES[: len(machine.letters)]):
        if letter in wanted:
            axes |= 1 << index
            values = axis_values(c, machine.find_axis(_MACHINE_AXES[index]), sample_now)
            block = struct.pack(f"<HBBiiiii{layout.torque}", *values)
            blocks += block + bytes(layout.axis - len(block))
    return bytes((first, axes)) + struct.pack("<H", len(blocks) + 4) + blocks


def _pack_general(c: CommandContext, layout: RecordLayout) -> bytes:
    machine = c.machine
    states = [bool(thread.running) for thread in machine.programs.threads]
    threads = sum(state << number for number, state in enumerate(states)) if layout.threads else any(states) << 7
    block = bytearray(layout.general)
    struct.pack_into("<H", block, 0, machine.time_counter() & 0xFFFF)
    block[2], block[12] = machine.io.input_byte(), machine.io.outputs
    block[layout.error], block[layout.error + 1] = min(machine.error_code, 255), threads
    return bytes(block)
