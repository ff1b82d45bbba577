"""Pipelined polls over a serial line, as many as its characters allow: one may begin before the previous reply has
arrived.

A USB adapter buffers received bytes for up to 16 ms, so that waiting for a reply before the next request would leave
the line idle. As soon as a poll's reply must have been transmitted, the next poll is written. Replies identify their
controller, and a poll that overlapped with a disturbance is repeated alone.
"""

import asyncio
from dataclasses import dataclass, replace

from adapters.yaskawa.language.numbers import parse_numbers
from adapters.yaskawa.smc2000.exchange import LineTiming
from adapters.yaskawa.smc2000.line import EarlyPoll, LineTurn, SharedSerialLine, address_command
from adapters.yaskawa.smc2000.session import SerialCommandSession
from adapters.yaskawa.wire.exchange import SmcCommandRefused, garbage_fault
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_until_ns
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import ControllerFault

DECODE_NS = NS_PER_MS  # of a poll: two commands, about half a millisecond each (L1000)
OVERLAPPED_NS = 30 * NS_PER_MS  # shorter wait for a poll that overlaps with another exchange
VALUE_CHARACTERS = 24  # of a printed value at most 13; the rest is for reports of other programs
AROUND_LINE = 4  # characters: the line's end, the prompts of address and command


@dataclass(frozen=True, slots=True)
class PrintedStatus:
    """A line that the controller's program has printed on request.

    sent_ns, received_ns: the host instants between which its first value was read.
    complete_ns: when all of it had arrived."""

    values: list[int]
    sent_ns: int
    received_ns: int
    complete_ns: int


class PolledSession(SerialCommandSession):
    """The exchanges of one controller, and its polls."""

    def __init__(self, line: SharedSerialLine, link: Link, clock: Clock, unit: int | None, timing: LineTiming) -> None:
        super().__init__(line, link, clock, unit, timing)
        self._length = 0
        """Length of the last poll's reply, characters; 0: none yet."""
        self._overlapped = False
        """The present poll was written before its turn, or has let the next one begin."""
        self._poll_command = ""
        self._quiet = (0, 0)

    async def request_status(self, command: str, count: int) -> PrintedStatus:
        """Let a program print its `count` values. Raises `SmcCommandRefused` when there is no such program.

        A poll that overlapped with another one, or was disturbed by a stop, is repeated alone.
        """
        line = self._line
        self._poll_command = command
        is_alone = False
        while True:
            await self._wait_until_allowed()
            async with LineTurn(line, self._unit, None if is_alone else self):
                if self._is_suspended():
                    continue
                stops, self._overlapped = line.stops, False
                try:
                    return await self._poll_once(command, count, alone=is_alone)
                except (ControllerFault, SmcCommandRefused):
                    line.mark_out_of_step()
                    if line.stops == stops:
                        if not self._overlapped:
                            raise
                        is_alone = True
                except LinkClosed:
                    line.drop_link(self._link)
                    raise
                except BaseException:
                    line.mark_out_of_step()
                    raise

    def suspend_polls(self, from_ns: int, until_ns: int) -> None:
        """Begin no poll in this interval: printing would take interpreter time from a program that is about to
        start."""
        self._quiet = (from_ns, until_ns)

    def poll_ahead(self) -> str | None:
        if self._is_suspended() or not self._serial.settled or not self._length:
            return None
        return f"{address_command(self._unit)}{self._poll_command}\r"

    # Polls

    def _is_suspended(self) -> bool:
        return self._quiet[0] <= self._clock.now_ns() < self._quiet[1]

    async def _wait_until_allowed(self) -> None:
        while self._is_suspended():
            await sleep_until_ns(self._clock, self._quiet[1])

    async def _poll_once(self, command: str, count: int, *, alone: bool) -> PrintedStatus:
        line = self._line
        request_ahead, line.ahead = line.ahead, None
        if request_ahead is not None and request_ahead.poller is self:
            self._overlapped = True
            self._serial.reset_buffer(request_ahead.plain, request_ahead.marked)
            self._serial.at_ns = max(self._serial.at_ns, request_ahead.at_ns)
            prefix, sent_ns = address_command(self._unit), request_ahead.sent_ns
        else:
            if request_ahead is not None:
                line.mark_out_of_step()
            if line.half_line or not (line.in_step and self._serial.settled):
                await self._select_controller()
            prefix = "" if line.selected == self._unit else address_command(self._unit)
            self._serial.reset_buffer()
            sent_ns = self._link.write(f"{prefix}{command}\r".encode("ascii"))
        stops, line.in_step, line.selected = line.stops, False, self._unit
        written_ns = sent_ns + (len(prefix) + len(command) + 1) * self._link.char_ns
        text = await self._poll_reply(command, written_ns, count * VALUE_CHARACTERS, alone=alone)
        values = [int(value) for value in parse_numbers(text, count, command)]
        if self._unit is not None and values[0] != self._unit:
            raise garbage_fault(self._link, command, f"an answer of unit {self._unit}", f"one of unit {values[0]}")
        self._length = len(text) + AROUND_LINE
        if line.stops != stops:
            line.mark_out_of_step()
        elif line.ahead is not None:
            buffers = {"plain": bytes(self._serial.plain), "marked": bytes(self._serial.marked)}
            line.ahead = replace(line.ahead, at_ns=self._serial.at_ns, **buffers)
        else:
            line.in_step = True
        begun_ns = self._serial.begun_ns(sent_ns, len(prefix) + len(command) + 1)
        return PrintedStatus(values, begun_ns, self._serial.emitted_ns(len(text) + 2), self._serial.at_ns)

    async def _poll_reply(self, command: str, written_ns: int, most: int, *, alone: bool) -> str:
        """Return the line that the program prints. When it must have been transmitted, even if it has not arrived yet,
        the next poll may begin. most: its characters, and those of reports of other programs."""
        char_ns = self._link.char_ns
        quiet_ns = written_ns + self._length * char_ns
        # An address takes effect at its end: it may be sent while the last characters are under way.
        over_ns = quiet_ns + DECODE_NS - len(address_command(self._unit)) * char_ns
        leads = not alone and self._length > 0
        byte_count = 0
        while True:
            text = self._take_printed_line(command)
            if text is not None:
                return text
            if byte_count > most:
                raise garbage_fault(self._link, command, f"at most {most} characters", f"{byte_count} of them")
            now_ns = self._clock.now_ns()
            if leads and now_ns >= over_ns:
                leads = False
                self._let_next_begin()
            silence_ns = self._serial.hold_ns + OVERLAPPED_NS if self._overlapped else self._serial.silence_ns
            give_up_ns = max(quiet_ns, self._serial.at_ns) + silence_ns
            if now_ns >= give_up_ns:
                raise self._serial.silence_fault(command)
            until_ns = min(give_up_ns, over_ns) if leads else give_up_ns
            try:
                async with asyncio.timeout((until_ns - now_ns) / NS_PER_S):
                    chunk = await self._link.read()
            except TimeoutError:
                continue
            byte_count += len(chunk.data)
            self._serial.plain += chunk.data
            self._serial.at_ns = chunk.at_ns

    def _let_next_begin(self) -> None:
        line = self._line
        poller = line.waiting[0].poller if line.waiting else None
        text = None if poller is None else poller.poll_ahead()
        if poller is not None and text is not None:
            line.ahead = EarlyPoll(poller, self._link.write(text.encode("ascii")))
            self._overlapped = True

    def _take_printed_line(self, command: str) -> str | None:
        """Return the line that the program has printed. Raises `SmcCommandRefused` when the command was refused.

        Another program's report of an error is printed as well, whichever controller is being polled (`?005 BGX`,
        L3473), also between two of the commands that print the line.
        """
        self._serial.separate_output()
        if b"?" in self._serial.plain:
            self._line.mark_out_of_step()
            self._serial.settled = False
            raise SmcCommandRefused(command, 0, "its resident program is missing")
        while (end := self._serial.marked.find(b"\r\n")) >= 0:
            text = self._serial.marked[:end].decode("ascii")
            printed_text, mark, report = text.partition("?")
            self._serial.marked[: end + 2] = printed_text.encode() if mark else b""
            if not mark:
                return text
            self.unsolicited.append(mark + report)
        return None
