"""Exchanges with one unit of a line: said again when the wire has spoilt them, given up in time, told in words.

A query, a setting and an upload from its beginning do no harm when they are said twice. What begins a motion is said
again only when the unit itself has answered that it has not understood it (E1, L1083-L1086).
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from adapters.contract import CannotDo, DriverFault
from adapters.smc30.frames import Reply, line
from adapters.smc30.line import LONGEST_REPLY, Disturbed, Line
from orchestrator.clock.base import Clock

_TRIES = 4
_ERRORS = {  # L1538-L1562
    "E2": "an argument is too long, or one was given where none is allowed",
    "E3": "its working memory is full",
    "E4": "it does not know the command, or can not comply",
    "E5": "a value is out of range, or the position counter has run over",
    "E6": "its permanent memory does not work",
}
DONE = re.compile("Y")
_REPLY_CODES = re.compile(r"[YBR]|E[1-6]")


class Busy(Exception):
    """The unit executes a program, or its motor turns: it has taken nothing (L1519-L1522)."""


@dataclass(frozen=True, slots=True)
class Answer:
    """sent_ns: the command was written then. at_ns: the latest instant at which the reply can have begun to be sent."""

    text: str
    sent_ns: int
    at_ns: int


class Session:
    """The conversation with one unit. unit: its address, None for one alone on its line."""

    def __init__(self, common: Line, clock: Clock, unit: int | None, with_checksum: bool) -> None:
        self.line = common
        self.unit = unit
        self.stops = 0
        """How many stops were written to it: what waits for its turn must not set it going after one."""
        self._clock = clock
        self.with_checksum = with_checksum

    # What others ask for

    async def ask(self, command: str, form: re.Pattern[str]) -> Answer:
        """The reply to a query. Raises `Busy`, `CannotDo` (refused), `DriverFault`."""
        return await self._said(command, form, repeatable=True)

    async def tell(self, command: str) -> None:
        """Give a setting. Raises like `ask`."""
        await self._said(command, DONE, repeatable=True)

    async def begin(self, command: str, since: int) -> Answer:
        """Give a command that must not be carried out twice, unless a stop has come since `stops` was `since`."""

        def still() -> None:
            self.require_no_stop(since)

        return await self._said(command, DONE, repeatable=False, still=still)

    async def upload(self, lines: Sequence[str], since: int) -> None:
        """Replace the program in working memory (L1882-L1891). Raises like `ask`; then no program is to be trusted."""
        for left in reversed(range(_TRIES)):
            try:
                await self.tell("PO")
                for each in lines:
                    await self.begin(each, since)
                await self.tell("PX")
            except DriverFault:
                if not left:
                    raise
            else:
                return

    async def listing(self) -> list[str]:
        """The program in working memory (Q, L1901-L1910): its lines, and Y behind them."""
        for left in reversed(range(_TRIES)):
            try:
                _, replies = await self._exchange("Q", lambda got: bool(got) and got[-1].text in ("Y", "B", "E1"), None)
            except Disturbed:
                continue
            texts = [reply.text for reply in replies]
            if texts and texts[-1] == "Y" and None not in texts:
                return [text for text in texts[:-1] if text is not None]
            if texts == ["B"]:
                raise Busy("Q")
            if not left:
                raise self._garbled("Q", "the program's lines and Y", replies)
        raise self._disturbed("Q")

    async def converse(self, command: str) -> str:
        """All that answers a line of a person, until nothing more comes."""
        try:
            _, replies = await self._exchange(command, lambda got: bool(got) and _ends(got[-1].text), None)
        except Disturbed:
            raise self._disturbed(command) from None
        if not replies:
            raise self._silent(command)
        return "\n".join("(garbled)" if reply.text is None else reply.text for reply in replies)

    def shout(self, *commands: str) -> int:
        """Write stops at once, past everything; host time of writing. Raises `LinkClosed`."""
        self.stops += 1
        return self.line.shout(b"".join(self.framed(command) for command in commands))

    def require_no_stop(self, since: int) -> None:
        if self.stops != since:
            raise CannotDo("stopped", f"{self.name} was stopped meanwhile", "try again")

    def framed(self, command: str) -> bytes:
        """`command` as it goes over the wire."""
        return line(command, self.unit, self.with_checksum)

    @property
    def name(self) -> str:
        """The unit, for people."""
        return self.line.link.place if self.unit is None else f"unit {self.unit} of {self.line.link.place}"

    # Inside

    async def _said(
        self, command: str, form: re.Pattern[str], *, repeatable: bool, still: Callable[[], None] | None = None
    ) -> Answer:
        refused = 0
        for left in reversed(range(_TRIES)):
            try:
                sent_ns, replies = await self._exchange(command, lambda got: bool(got), still)
            except Disturbed:
                if not repeatable:
                    raise self._disturbed(command) from None
                continue
            reply = replies[0] if replies else None
            text = None if reply is None else reply.text
            if reply is not None and text is not None:
                if form.fullmatch(text):
                    return Answer(text, sent_ns, reply.at_ns - self.line.wire_ns(reply.characters))
                if text == "B":
                    raise Busy(command)
                if text in _ERRORS and (refused or not repeatable):
                    raise self._refused(command, text)
                refused += text in _ERRORS
            # E1: the unit has taken nothing. Anything else: nobody knows what it has taken.
            if not left or (not repeatable and text != "E1"):
                raise self._silent(command) if reply is None else self._garbled(command, form.pattern, replies)
        raise self._disturbed(command)

    async def _exchange(
        self, command: str, whole: Callable[[list[Reply]], bool], still: Callable[[], None] | None
    ) -> tuple[int, list[Reply]]:
        return await self.line.exchange(self.unit, self.framed(command), whole, LONGEST_REPLY, still)

    def _refused(self, command: str, text: str) -> CannotDo:
        return CannotDo(
            "refused",
            f"{self.name} answers {text} to {command!r}: {_ERRORS[text]}",
            "was it switched off, or has somebody else programmed it? Try again",
        )

    def _silent(self, command: str) -> DriverFault:
        return DriverFault(
            "no-answer",
            f"{self.name} does not answer {command!r}",
            "check power, cable, baud rate, the address switches A0-A2, and 7 data bits with odd parity",
        )

    def _garbled(self, command: str, expected: str, replies: Sequence[Reply]) -> DriverFault:
        found = (
            ", ".join("a garbled line" if reply.text is None else repr(reply.text) for reply in replies) or "nothing"
        )
        return DriverFault(
            "garbage",
            f"{self.name}: sent {command!r}, expected {expected}, received {found}",
            "check cable and ground, the switch CHS against option `checksum`, and that no address is given twice",
        )

    def _disturbed(self, command: str) -> CannotDo:
        return CannotDo("stopped", f"{self.name}: a stop on the line came while {command!r} was said", "try again")


def _ends(text: str | None) -> bool:
    return text is None or _REPLY_CODES.fullmatch(text) is not None or text[:1] == "V"
