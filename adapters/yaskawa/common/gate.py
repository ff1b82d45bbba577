"""Timing of the release gate of the resident program, in samples: how long before the start it is decided, and which
commands must have arrived by then.

The commands there take the same time whatever the sample period (TM) is.
"""

from dataclasses import dataclass
from math import ceil

from adapters.yaskawa.common.options import YaskawaOptions
from orchestrator.clock.base import NS_PER_MS, NS_PER_US

# How often the resident program looks, and how many commands its turns take.
STEP_TICKS = 4  # between two checks of the release gate
FOLLOWING_STEP_TICKS = 2  # between two looks of a step that follows another one
LAST_LOOK_TICKS = 6  # before its start
BEGIN_TICKS = 3  # before its start: the jump and the wait still fit
FOLLOWING_COMMANDS = 10  # from the end of the present step to the wait of the following one, in its thread
SINGLE_CONDITIONS = 4  # further ones where conditions cannot be combined
SHORT_CHECK_AXES = 2  # of a controller: for more, the check of the positions takes a command of its own
STAMP_COMMANDS = 2  # for each axis of the present step, in that one's thread
RELEASED_COMMANDS = 6  # from a release at rest to the wait
AT_ONCE_TICKS = 2  # from the end of a step to the begin of one at once, at the least
AT_ONCE_LATEST_NS = 25 * NS_PER_MS  # its latest begin after that, and after its release, while the host sends commands
LATE_LOOK_TICKS = 12  # after the start of a step behind another one: by then its variables are in their place
SPARE_TICKS = 2  # for commands that take longer than usual

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
    follow_before: the same for a step that follows another one, once that has ended.
    command_ns: duration of a command. turn_commands: from the end of a step to the wait of the one that follows it.
    """

    wait_after_gate: int
    usual_delay: int
    longest_delay: int
    decided_before: int
    release_before: int
    follow_before: int
    command_ns: int
    turn_commands: int

    @classmethod
    def for_options(cls, options: YaskawaOptions, interleaved: int = 0, single_conditions: int = 0) -> "GateTiming":
        """Return the timing for `options`. interleaved: further commands in a check, or commands of other threads
        that may interrupt it. single_conditions: further commands because conditions cannot be combined."""
        command_ns = max(COMMAND_US, options.decode_us) * NS_PER_US

        def to_ticks(commands: int) -> int:
            return ceil(commands * command_ns / options.tick_ns)

        room, seen_ticks = to_ticks(ROOM), STEP_TICKS + to_ticks(SEEN)
        decision_ticks = room + seen_ticks + to_ticks(interleaved)
        released_commands = RELEASED_COMMANDS + single_conditions
        follow = FOLLOWING_STEP_TICKS + to_ticks(released_commands + released_commands // 2) + BEGIN_TICKS
        release, turn = decision_ticks + to_ticks(RELEASE), FOLLOWING_COMMANDS + single_conditions
        return cls(
            wait_after_gate=room,
            usual_delay=STEP_TICKS + to_ticks(SOON),
            longest_delay=seen_ticks,
            decided_before=decision_ticks,
            release_before=release,
            follow_before=follow,
            command_ns=command_ns,
            turn_commands=turn,
        )

    def gap_ticks(self, moved: int, axes: int, tick_ns: float) -> int:
        """Return how many samples after the end of a step that moved `moved` of `axes` axes another one can begin that
        follows it."""
        commands = self.turn_commands + (axes > SHORT_CHECK_AXES) + STAMP_COMMANDS * moved
        return 1 + ceil(commands * self.command_ns / tick_ns) + BEGIN_TICKS + SPARE_TICKS
