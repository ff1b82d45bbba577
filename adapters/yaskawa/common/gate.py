"""Timing of the release gate of the resident program, in samples: how long before the start it is decided, and which
commands must have arrived by then.

The commands there take the same time whatever the sample period (TM) is.
"""

from dataclasses import dataclass
from math import ceil

from adapters.yaskawa.common.options import YaskawaOptions
from orchestrator.clock.base import NS_PER_US

STEP_TICKS = 4  # between two checks
COMMAND_US = 500  # about half a millisecond (SMC-4000: L1626); no gate assumes less
ROOM, SEEN, SOON, RELEASE = 16, 11, 3, 15  # commands


@dataclass(frozen=True, slots=True)
class GateTiming:
    """Timing of the release gate, in samples.

    wait_after_gate: from the gate to the wait: eight commands, each of which may take twice as long.
    longest_delay: longest delay until the program notices the open gate: one round of its loop.
    usual_delay: typical delay until then (the wait, the jump, and the line after it).
    decided_before: before the start; a release at the last moment is still noticed, and the wait is reached in time.
    release_before: before the start; the latest time at which the release must be sent.
    """

    wait_after_gate: int
    usual_delay: int
    longest_delay: int
    decided_before: int
    release_before: int

    @classmethod
    def for_options(cls, options: YaskawaOptions, interleaved: int = 0) -> "GateTiming":
        """Return the timing for `options`. interleaved: further commands in a check, or commands of other threads
        that may
        interrupt it."""
        command_ns = max(COMMAND_US, options.decode_us) * NS_PER_US

        def to_ticks(commands: int) -> int:
            return ceil(commands * command_ns / options.tick_ns)

        room, seen = to_ticks(ROOM), STEP_TICKS + to_ticks(SEEN)
        decided = room + seen + to_ticks(interleaved)
        return cls(room, STEP_TICKS + to_ticks(SOON), seen, decided, decided + to_ticks(RELEASE))
