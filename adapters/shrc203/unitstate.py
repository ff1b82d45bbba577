"""The driver's knowledge of the controller between two commands."""

import asyncio
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field

from adapters.shrc203.buffers import PrebufferControl
from adapters.shrc203.replies import speed_list
from adapters.shrc203.session import ShrcSession
from adapters.shrc203.timing import ShrcTiming
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal


@dataclass(slots=True)
class ShrcState:
    """One connection to one controller.

    excited, closed_loop: last known, by motor.
    sentinel: query and its expected reply.
    untidy: a stop may have left moves in the prebuffers.
    loading: lock for filling or emptying them.
    sound: no error was present at the last poll.
    jogging_motors: motors that were last started by a jog, which sends no completion line.
    waiting: motors in an input wait, as far as is known, with their positions in pulses.
    line_starts: whether the controller accepts such waits.
    outputs: value of all outputs as last read or written.
    driving: a step switches an output.
    chaining: a chain of moves is loaded or in progress.
    timing: observations of the move in progress.
    """

    session: ShrcSession
    controllable: tuple[int, ...] = ()
    excited: dict[int, bool] = field(default_factory=dict[int, bool])
    closed_loop: dict[int, bool] = field(default_factory=dict[int, bool])
    sentinel: tuple[str, str] = ("", "")
    untidy: bool = False
    sound: bool = True
    loading: asyncio.Lock = field(default_factory=asyncio.Lock)
    jogging_motors: set[int] = field(default_factory=set[int])
    waiting: dict[int, int] = field(default_factory=dict[int, int])
    line_starts: bool = True
    outputs: int = 0
    driving: bool = False
    chaining: bool = False
    timing: ShrcTiming | None = None
    _stop_counts: Counter[int] = field(default_factory=Counter[int])

    @property
    def prebuffers(self) -> PrebufferControl:
        return PrebufferControl(self.session, self.controllable)

    @property
    def untidy_at_rest(self) -> bool:
        """Whether the prebuffers must be emptied, and can be: in an error state no command is accepted, and nothing
        starts."""
        return self.untidy and self.sound

    async def is_restarted(self) -> bool:
        """Return whether the controller has lost its sentinel. Queried after another exchange, False also validates the
        reply of that exchange."""
        query, due = self.sentinel
        return await self.session.send_query(query, speed_list(1)) != due

    async def make_harmless(self) -> None:
        """Ensure that no queued move can move an axis, now, and later when the error of its axis has been cleared.

        Never starts a move. Raises `ControllerFault` (code `still-armed`)."""
        if not await self.prebuffers.make_harmless(self.excited):
            self.untidy = True

    # Starts and stops

    def record_stop(self, motors: Iterable[int]) -> None:
        """Record a stop that is written for these motors: commands that wait for their turn on the line must not start
        them afterwards."""
        self._stop_counts.update(motors)

    def stop_count(self, motor: int) -> int:
        """Return a number that every stop of this motor increments."""
        return self._stop_counts[motor]

    def require_no_stop(self, axis: str, motor: int, since: int) -> None:
        """Raise `Refusal` when a stop has come since `stop_count` returned `since`."""
        if self._stop_counts[motor] != since:
            raise Refusal("stopped", f"axis {axis} was stopped meanwhile", "")

    async def start_motion(self, command: str, axis: str, motor: int, since: int) -> None:
        """Send a command that moves one motor, unless a stop has come since `stop_count` returned `since`.

        The line keeps the order of writes, so that a later stop is executed later. Raises `Refusal`; then the motor is
        at rest.
        """
        sent = False

        def check_no_stop() -> None:
            nonlocal sent
            self.require_no_stop(axis, motor, since)
            sent = True

        try:
            await self.session.send_setting(command, check_no_stop)
        except Refusal:
            raise
        except BaseException:
            # Cancelled or unanswered: no caller would stop it later.
            if sent:
                with suppress(LinkClosed):
                    self.brake_motors([motor])
            raise

    def brake_motors(self, motors: Iterable[int]) -> None:
        """Send `L:` to each motor singly, now: for several at once it is refused where one motor is off (L2988)."""
        lines = [f"L:{motor}" for motor in motors]
        if lines:
            self.session.write_at_once(*lines)
