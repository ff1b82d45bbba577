"""What the driver knows of the unit between two commands."""

import asyncio
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field

from adapters.contract import CannotDo
from adapters.shrc203.buffers import Buffers
from adapters.shrc203.replies import triples
from adapters.shrc203.session import Session
from adapters.shrc203.timing import Timing
from orchestrator.link.base import LinkClosed


@dataclass(slots=True)
class UnitState:
    """One connection to one unit. excited, closed_loop: last known, by motor. sentinel: query and its due reply.

    untidy: a stop may have left something in the prebuffers. loading: held by whoever fills or empties them. sound: no
    error stood at the last poll.
    by_hand: motors that were last set going by a jog, which sends no completion line.
    waiting: motors in standby for an input, as far as is known, with the pulses where they stand. line_starts: whether
    the unit takes such standbys. outputs: value of all outputs as last read or written; driving: a step switches one.
    chaining: a chain of moves is loaded or under way. timing: what is seen of the move that is under way.
    """

    session: Session
    controllable: tuple[int, ...] = ()
    excited: dict[int, bool] = field(default_factory=dict[int, bool])
    closed_loop: dict[int, bool] = field(default_factory=dict[int, bool])
    sentinel: tuple[str, str] = ("", "")
    untidy: bool = False
    sound: bool = True
    loading: asyncio.Lock = field(default_factory=asyncio.Lock)
    by_hand: set[int] = field(default_factory=set[int])
    waiting: dict[int, int] = field(default_factory=dict[int, int])
    line_starts: bool = True
    outputs: int = 0
    driving: bool = False
    chaining: bool = False
    timing: Timing | None = None
    _stops_given: Counter[int] = field(default_factory=Counter[int])

    @property
    def buffers(self) -> Buffers:
        return Buffers(self.session, self.controllable)

    @property
    def untidy_at_rest(self) -> bool:
        """Whether the prebuffers are to be emptied, and can be: in an error nothing is taken, and nothing starts."""
        return self.untidy and self.sound

    async def is_restarted(self) -> bool:
        """Whether the unit has lost its sentinel: asked behind something else, what that has said is true of a unit
        that was not restarted if this is false."""
        query, due = self.sentinel
        return await self.session.ask(query, triples(1)) != due

    async def make_harmless(self) -> None:
        """See to it that nothing queued can move an axis, now, and later when the error of its axis has been cleared.
        Never starts a move. Raises `DriverFault` (code `still-armed`)."""
        if not await self.buffers.make_harmless(self.excited):
            self.untidy = True

    # Setting going, and stopping

    def count_stop(self, motors: Iterable[int]) -> None:
        """A stop is written for these motors: what waits for its turn on the line must not set them going after it."""
        self._stops_given.update(motors)

    def stops_given(self, motor: int) -> int:
        """A number that every stop of this motor raises."""
        return self._stops_given[motor]

    def require_no_stop(self, axis: str, motor: int, since: int) -> None:
        """Raises `CannotDo` when a stop has come since `stops_given` was `since`."""
        if self._stops_given[motor] != since:
            raise CannotDo("stopped", f"axis {axis} was stopped meanwhile", "")

    async def set_going(self, command: str, axis: str, motor: int, since: int) -> None:
        """Send a line that moves one motor, unless a stop has come since `stops_given` was `since`.

        The line keeps the order of what is written to it, so that a stop written later is carried out later. Raises
        `CannotDo`; then the motor stands still.
        """
        sent = False

        def still() -> None:
            nonlocal sent
            self.require_no_stop(axis, motor, since)
            sent = True

        try:
            await self.session.tell(command, still)
        except CannotDo:
            raise
        except BaseException:
            # Cancelled, or without an answer: nobody would stop it any more.
            if sent:
                with suppress(LinkClosed):
                    self.brake([motor])
            raise

    def brake(self, motors: Iterable[int]) -> None:
        """`L:` to each by itself, now: for several at once it is refused where one motor is off (L2988)."""
        lines = [f"L:{motor}" for motor in motors]
        if lines:
            self.session.interrupt(*lines)
