"""A probe of several axes of an SMC-4000 on a straight line: a sequence of one segment, by the resident program.

The controller plans one speed along the line (LM, LI; L12992-13019), so that its axes begin, brake and end together
exactly on it: `STS` stops the sequence along its path (L13007). What an axis is off the line is what it lags behind.
Positions are read one after the other behind the stop; each has its own time since the edge.
"""

from collections.abc import Iterable, Mapping
from math import hypot

from adapters.contract import LimitMove, ProbeMove
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import LINE_PROBE_LABEL, STEP_THREAD
from adapters.yaskawa.triggers.probe import REACTION_S, brake_sequence
from adapters.yaskawa.triggers.program_probe import ProgramProbe, find_program_ability, find_read_us
from adapters.yaskawa.wire.record import AXIS_LETTERS, DataRecord
from orchestrator.model.errors import Refusal
from orchestrator.model.state import ProbeAbility

LONGEST_WAY = 8_388_607  # counts of an axis (LI, L6877)
SPEED_MAX = 8_000_000  # counts/s along the line (VS, L11625)
LINE_COUNTS = 2.0  # positions are rounded, as are those of the line


def find_line_ability(motors: Mapping[str, int], options: YaskawaOptions) -> ProbeAbility:
    """Any of the local inputs stops the axes of a line. motors: by axis, its index."""
    axis_ability = find_program_ability(list(motors), options)
    last_read_us = find_read_us(options, max(motors.values()) + 1)
    return axis_ability.model_copy(
        update={"contact_s": last_read_us / 1e6, "line_s": REACTION_S, "line_counts": LINE_COUNTS}
    )


class LineProbe(ProgramProbe):
    """A probe of several axes, all of which move."""

    END_CODE = 101  # the end of a sequence (L9858-9899)

    @property
    def _label(self) -> str:
        return LINE_PROBE_LABEL

    def _list_commands(self, moves: Mapping[str, ProbeMove], record: DataRecord) -> Iterable[str]:
        ways = {
            self._motors[axis]: move.end_counts - record.axes[self._motors[axis]].commanded
            for axis, move in moves.items()
        }
        for axis, move in moves.items():
            if abs(ways[self._motors[axis]]) > LONGEST_WAY:
                text = f"axis {axis} would go {abs(ways[self._motors[axis]])} counts, to {move.end_counts}"
                raise Refusal("too-far", f"{text}; a line has at most {LONGEST_WAY}", "probe less far")
        registers = self._find_registers(
            LimitMove(
                0,
                min(SPEED_MAX, hypot(*(move.speed_counts_s for move in moves.values()))),
                hypot(*(move.ramp_counts_s2 for move in moves.values())),
            )
        )
        letters = "".join(AXIS_LETTERS[index] for index in sorted(ways))
        way = ",".join(str(ways.get(index, "")) for index in range(max(ways) + 1))
        return (
            "CAS",
            f"LM {letters}",
            "CSS",  # what a stopped sequence has left is not stated
            "VT 1",
            f"VA {registers.ramp}",
            f"VD {registers.ramp}",
            f"VS {registers.speed}",
            f"LI {way}",
            "LE",
        )

    def _brake(self) -> None:
        brake_sequence(self._device, f"HX{STEP_THREAD}")

    def _find_read_us(self, index: int) -> float:
        return find_read_us(self._options, index + 1)
