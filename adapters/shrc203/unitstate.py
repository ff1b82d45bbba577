"""The driver's knowledge of the controller between two commands."""

import asyncio
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from adapters.shrc203.buffers import PrebufferControl
from adapters.shrc203.timing import ShrcTiming
from adapters.shrc203.wire.replies import speed_list
from adapters.shrc203.wire.session import ShrcSession
from adapters.toolkit.stop_counter import StopCounter, send_or_brake


class CountsReading(NamedTuple):
    """Coordinates by motor, pls, as they were between the question and its answer."""

    asked_ns: int
    at_ns: int
    counts: Mapping[int, int]


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
    trigger_set: the trigger output may pulse when an axis moves. readings: of the polls since it was set.
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
    trigger_set: bool = False
    readings: list[CountsReading] = field(default_factory=list[CountsReading])
    stops: StopCounter = field(default_factory=StopCounter)

    @property
    def prebuffers(self) -> PrebufferControl:
        return PrebufferControl(self.session, self.controllable)

    @property
    def untidy_at_rest(self) -> bool:
        """Whether the prebuffers must be emptied, or the trigger output ended, and can be: in an error state no command
        is accepted, and nothing starts."""
        return (self.untidy or self.trigger_set) and self.sound

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
            self.session.log.warning("a prebuffer could not be emptied; it is emptied once the controller accepts it")

    async def end_trigger(self) -> None:
        """End what the trigger output was set to, before anything else moves. Raises `Refusal`."""
        if self.trigger_set:
            await self.session.send_setting("T:S")
            self.trigger_set = False

    # Starts and stops

    async def start_motion(self, command: str, axis: str, motor: int, since: int) -> None:
        """Send a command that moves one motor, unless a stop has come since `stops.stop_count` returned `since`.

        The line keeps the order of writes, so that a later stop is executed later. Raises `Refusal`; then the motor is
        at rest.
        """
        await send_or_brake(
            lambda check: self.session.send_setting(command, check),
            lambda: self.stops.require_no_stop(axis, motor, since),
            lambda: self.brake_motors([motor]),
        )

    def brake_motors(self, motors: Iterable[int]) -> None:
        """Send `L:` to each motor singly, now: for several at once it is refused where one motor is off (L2988)."""
        lines = [f"L:{motor}" for motor in motors]
        if lines:
            self.session.write_at_once(*lines)
