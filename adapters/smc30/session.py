"""Exchanges with one controller of a line: repeated after transmission errors, limited by timeouts, with described
errors.

A query, a setting and an upload from its beginning may be sent twice without harm. A command that begins a motion is
repeated only when the controller itself has answered that it did not understand it (E1, L1083-L1086).
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from adapters.contract import NULL_LOG
from adapters.smc30.frames import ReceivedReply, frame_line
from adapters.smc30.line import LONGEST_REPLY, ExchangeDisturbed, Smc30Line
from orchestrator.clock.base import Clock
from orchestrator.model.errors import ControllerFault, Refusal, TuttiError

_TRIES = 4
_ERRORS = {  # L1538-L1562
    "E2": "an argument is too long, or one was given where none is allowed",
    "E3": "its working memory is full",
    "E4": "it does not recognise the command, or cannot execute it",
    "E5": "a value is out of range, or the position counter has overflowed",
    "E6": "its permanent memory does not work",
}
DONE = re.compile("Y")
_REPLY_CODES = re.compile(r"[YBR]|E[1-6]")


class ControllerBusy(TuttiError):
    """The controller executes a program, or its motor moves: it has accepted nothing (L1519-L1522)."""


@dataclass(frozen=True, slots=True)
class Smc30Answer:
    """A reply. sent_ns: when the command was written. at_ns: the latest instant at which the reply can have begun to be
    sent."""

    text: str
    sent_ns: int
    at_ns: int


class Smc30Session:
    """The exchanges with one controller. unit: its address, None for one alone on its line."""

    def __init__(self, common: Smc30Line, clock: Clock, unit: int | None, *, with_checksum: bool) -> None:
        self.line = common
        self.log = NULL_LOG
        self.unit = unit
        self.stops = 0
        """Number of stops written to it: a command that waits for its turn must not start it after a stop."""
        self._clock = clock
        self.with_checksum = with_checksum

    # The public exchanges

    async def send_query(self, command: str, form: re.Pattern[str]) -> Smc30Answer:
        """Return the reply to a query. Raises `ControllerBusy`, `Refusal`, `ControllerFault`."""
        return await self._send_command(command, form, repeatable=True)

    async def send_setting(self, command: str) -> None:
        """Send a setting. Raises like `send_query`."""
        await self._send_command(command, DONE, repeatable=True)

    async def send_once(self, command: str, since: int) -> Smc30Answer:
        """Send a command that must not be executed twice, unless a stop has come since `stops` was `since`."""

        def check_no_stop() -> None:
            self.require_no_stop(since)

        return await self._send_command(command, DONE, repeatable=False, before_send=check_no_stop)

    async def upload_program(self, lines: Sequence[str], since: int) -> None:
        """Replace the program in working memory (L1882-L1891). Raises like `send_query`; then the program in memory is
        undefined."""
        for tries_left in reversed(range(_TRIES)):
            try:
                await self.send_setting("PO")
                for line in lines:
                    await self.send_once(line, since)
                await self.send_setting("PX")
            except ControllerFault as error:
                self.log.warning(f"the upload of the program failed: {error.text}", tries_left=tries_left)
                if not tries_left:
                    raise
            else:
                return

    async def list_program(self) -> list[str]:
        """Return the program in working memory (Q, L1901-L1910): its lines, and Y after them."""
        for tries_left in reversed(range(_TRIES)):
            try:
                _, replies = await self._run_exchange(
                    "Q", lambda answers: bool(answers) and answers[-1].text in ("Y", "B", "E1"), None
                )
            except ExchangeDisturbed:
                continue
            texts = [reply.text for reply in replies]
            if texts and texts[-1] == "Y" and None not in texts:
                return [text for text in texts[:-1] if text is not None]
            if texts == ["B"]:
                raise ControllerBusy("Q")
            if not tries_left:
                raise self._garbled_fault("Q", "the program's lines and Y", replies)
        raise self._disturbed_refusal("Q")

    async def send_raw(self, command: str) -> str:
        """Return all replies to a raw command, until silence."""
        try:
            _, replies = await self._run_exchange(
                command, lambda answers: bool(answers) and _ends_upload(answers[-1].text), None
            )
        except ExchangeDisturbed:
            raise self._disturbed_refusal(command) from None
        if not replies:
            raise self._silence_fault(command)
        return "\n".join("(garbled)" if reply.text is None else reply.text for reply in replies)

    def write_at_once(self, *commands: str) -> int:
        """Write stops at once, bypassing everything; return the host time of writing. Raises `LinkClosed`."""
        self.stops += 1
        return self.line.write_at_once(b"".join(self.frame_command(command) for command in commands))

    def require_no_stop(self, since: int) -> None:
        if self.stops != since:
            raise Refusal("stopped", f"{self.name} was stopped meanwhile", "try again")

    def frame_command(self, command: str) -> bytes:
        """Return the transmitted form of `command`."""
        return frame_line(command, self.unit, with_checksum=self.with_checksum)

    @property
    def name(self) -> str:
        """The name of the controller in messages."""
        return self.line.link.endpoint if self.unit is None else f"unit {self.unit} of {self.line.link.endpoint}"

    # Internals

    async def _send_command(
        self, command: str, form: re.Pattern[str], *, repeatable: bool, before_send: Callable[[], None] | None = None
    ) -> Smc30Answer:
        refusals = 0
        for tries_left in reversed(range(_TRIES)):
            try:
                sent_ns, replies = await self._run_exchange(command, lambda answers: bool(answers), before_send)
            except ExchangeDisturbed:
                if not repeatable:
                    raise self._disturbed_refusal(command) from None
                self.log.info(f"{command!r} is repeated: a stop on the line came during the exchange")
                continue
            reply = replies[0] if replies else None
            text = None if reply is None else reply.text
            if reply is not None and text is not None:
                if form.fullmatch(text):
                    return Smc30Answer(text, sent_ns, reply.at_ns - self.line.wire_ns(reply.characters))
                if text == "B":
                    raise ControllerBusy(command)
                if text in _ERRORS and (refusals or not repeatable):
                    raise self._command_refusal(command, text)
                refusals += text in _ERRORS
            if text is not None and text not in _ERRORS and text != "E1":
                self.line.discard_late_replies()  # It may be the late reply to an earlier command.
            # E1: the controller has accepted nothing. Any other reply: the result is unknown.
            if not tries_left or (not repeatable and text != "E1"):
                raise (
                    self._silence_fault(command)
                    if reply is None
                    else self._garbled_fault(command, form.pattern, replies)
                )
            self.log.warning(f"{command!r} is repeated", answer=text or "none", tries_left=tries_left)
        raise self._disturbed_refusal(command)

    async def _run_exchange(
        self, command: str, whole: Callable[[list[ReceivedReply]], bool], before_send: Callable[[], None] | None
    ) -> tuple[int, list[ReceivedReply]]:
        return await self.line.run_exchange(self.unit, self.frame_command(command), whole, LONGEST_REPLY, before_send)

    def _command_refusal(self, command: str, text: str) -> Refusal:
        return Refusal(
            "refused",
            f"{self.name} answers {text} to {command!r}: {_ERRORS[text]}",
            "was it switched off, or has another client programmed it? Try again",
        )

    def _silence_fault(self, command: str) -> ControllerFault:
        return ControllerFault(
            "no-answer",
            f"{self.name} does not answer {command!r}",
            "check power, cable, baud rate, the address switches A0-A2, and 7 data bits with odd parity",
        )

    def _garbled_fault(self, command: str, expected: str, replies: Sequence[ReceivedReply]) -> ControllerFault:
        received_text = (
            ", ".join("a garbled line" if reply.text is None else repr(reply.text) for reply in replies) or "nothing"
        )
        return ControllerFault(
            "garbage",
            f"{self.name}: sent {command!r}, expected {expected}, received {received_text}",
            "check cable and ground, the switch CHS against option `checksum`, and that each address exists once",
        )

    def _disturbed_refusal(self, command: str) -> Refusal:
        return Refusal("stopped", f"{self.name}: a stop on the line came during {command!r}", "try again")


def _ends_upload(text: str | None) -> bool:
    return text is None or _REPLY_CODES.fullmatch(text) is not None or text[:1] == "V"
