"""What differs between the models that play triggers."""

from dataclasses import dataclass

from adapters.yaskawa.common.program import LEVEL_LABEL, PULSE_LABEL, RING_LEVEL_LABEL, RING_PULSE_LABEL, TABLE
from adapters.yaskawa.wire.session import MAX_PACKET

UPLOAD_ELEMENTS = 100  # at once, over a network


@dataclass(frozen=True, slots=True)
class TriggerTraits:
    """A model's program and line.

    pulse_label, level_label: entries of its program; pulse_commands, level_commands: of one round of it, a wait with
    an expression counted twice. other_commands: of the host, the watchdog and polls in one round.
    ring_labels: entries of its program, for pulses and levels, that play a ring; ring_commands: how many more commands
    one round has there. beside: commands of other threads that may come before each of its own. contour_commands: of
    its thread in one record of a contour.
    packet: characters of elements that are sent at once; back: elements that are read at once; char_ns: of a serial
    line, 0 for a network.
    """

    pulse_label: str = PULSE_LABEL
    level_label: str = LEVEL_LABEL
    pulse_commands: int = 8
    level_commands: int = 7
    other_commands: int = 5
    ring_labels: tuple[str, str] = (RING_PULSE_LABEL, RING_LEVEL_LABEL)
    ring_commands: int = 1
    beside: int = 0
    contour_commands: float = 1.0  # two at most, and none with an expression; the contour's own are counted twice
    packet: int = MAX_PACKET - len(f"QD {TABLE}[],99999,99999\r\x1a")
    back: int = UPLOAD_ELEMENTS
    char_ns: int = 0

    def find_label(self, *, turns: bool, is_ring: bool) -> str:
        """The entry of the program. turns: for levels."""
        return (self.ring_labels if is_ring else (self.pulse_label, self.level_label))[turns]


SMC4000_TRIGGERS = TriggerTraits()
