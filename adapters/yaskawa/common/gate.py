"""The gate of the resident program in samples: how long before the start it is decided, and what must be told by then.

What takes its time there are commands, and they take it however long a sample is (TM).
"""

from dataclasses import dataclass
from math import ceil

from adapters.yaskawa.common.options import Options
from orchestrator.clock.base import NS_PER_US

STEP_TICKS = 4  # between two looks
COMMAND_US = 500  # about half a millisecond (SMC-4000: L1626); no gate counts on less
ROOM, SEEN, SOON, RELEASE = 16, 11, 3, 15  # commands


@dataclass(frozen=True, slots=True)
class Gate:
    """In samples.

    room: from the gate to the wait, which is eight commands; each may take twice as long. seen: at most so long after
    it opens, the program has seen it: one round of its loop; soon: as a rule it has by then (the wait, the jump, and
    the line behind it). decided: before the start; who opens it just in time is still seen, and waits in time. release:
    before the start, by when the release must be on its way.
    """

    room: int
    soon: int
    seen: int
    decided: int
    release: int

    @classmethod
    def of(cls, options: Options, beside: int = 0) -> "Gate":
        """beside: commands that a look takes besides, or others' that may come into it."""
        command_ns = max(COMMAND_US, options.decode_us) * NS_PER_US

        def ticks(commands: int) -> int:
            return ceil(commands * command_ns / options.tick_ns)

        room, seen = ticks(ROOM), STEP_TICKS + ticks(SEEN)
        decided = room + seen + ticks(beside)
        return cls(room, STEP_TICKS + ticks(SOON), seen, decided, decided + ticks(RELEASE))
