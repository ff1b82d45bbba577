"""A serial port with one controller behind it, or with a daisy chain of them: opened once, spoken to in turns.

Everything that the units of a chain have in common is here: the open link, whose turn it is, and which unit hears what
is written (%A, L945). A stop goes past all turns: each command is written as a whole, so that it always begins at the
beginning of a line, and whatever is under way finds out by `stops` that it has been disturbed.
"""

import asyncio
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol

from orchestrator.link.base import Link, LinkClosed, OpenLink

SHARED = "yaskawa serial line"
"""Where the drivers of one line find it in `Setup.shared`."""


class Poller(Protocol):
    """Somebody who waits for a turn to poll."""

    def poll_ahead(self) -> str | None:
        """What to write for it before its turn has come; None: nothing now."""
        ...


@dataclass(frozen=True, slots=True)
class Ahead:
    """A poll that was written before its turn, while the reply before it was still kept by the serial adapter.

    plain, marked: what has come for it already, by at_ns.
    """

    poller: Poller
    sent_ns: int
    at_ns: int = 0
    plain: bytes = b""
    marked: bytes = b""


class Line:
    """One port. Made before any loop runs; every unit of the line joins it when its driver is built.

    selected: the unit that hears commands; None: nobody knows. in_step: every byte that was asked for has come.
    stops: how many stops were written so far. loading: what is written now is taken as a program's text.
    """

    def __init__(self) -> None:
        self.turn = asyncio.Lock()
        self.owner: asyncio.Task[object] | None = None
        """Whose turn it is."""
        self.units: set[int | None] = set()
        self.selected: int | None = None
        self.in_step = False
        self.stops = 0
        self.loading = False
        self.half_line = False
        """A download has ended without CR: to units that were not addressed, the next address begins no line."""
        self.answered = False
        """Somebody has answered since the port was opened."""
        self.ahead: Ahead | None = None
        self.missing: set[int | None] = set()
        """Units of a chain that did not answer when they were last asked, whoever asks again."""
        self.waiting: deque[Turn] = deque()
        """In the order in which they are given."""
        self.others = 0
        """Turns since the last one of a missing unit: so many go before the next one, as long as somebody waits."""
        self._opening = asyncio.Lock()
        self._link: Link | None = None
        self._users: set[int | None] = set()
        self._markers = 0

    async def attach(self, unit: int | None, open_link: OpenLink) -> Link:
        """The open port; opened if nobody else has. Raises `LinkRefused`."""
        async with self._opening:
            if self._link is None:
                self._link = await open_link()
                self.selected, self.in_step, self.ahead, self.loading, self.answered = None, False, None, False, False
            self._users.add(unit)
            return self._link

    async def detach(self, unit: int | None) -> None:
        """A unit is left; the port is closed after the last one."""
        async with self._opening:
            self._users.discard(unit)
            if not self._users and self._link is not None:
                link, self._link = self._link, None
                await link.close()

    def lost(self, link: Link) -> None:
        """`link` is closed: whoever comes next opens a new one."""
        if self._link is link:
            self._link = None

    def out_of_step(self) -> None:
        """Bytes may be under way that nobody waits for, and nobody knows who listens."""
        self.in_step, self.selected, self.ahead = False, None, None

    def marker(self) -> str:
        """A text that no reply before it can hold."""
        self._markers += 1
        return f"<{self._markers}>"

    def shout(self, link: Link, unit: int | None, commands: Iterable[str], unknown: bool = False) -> None:
        """Write commands to a unit at once, past everything that is under way. Raises `LinkClosed`.

        unknown: nobody knows what was said on this line before.
        """
        self.stops += 1
        # In the middle of a download commands would be program text, and a backslash ends it (L8205).
        ended = "\\\r" if self.loading or unknown else ""
        text = ended + address(unit) + "".join(f"{command}\r" for command in commands)
        self.out_of_step()
        try:
            link.write(text.encode("ascii"))
        except LinkClosed:
            self.lost(link)
            raise


class Turn:
    """`async with`: a turn on the line for `unit`; within a turn of the same task, a part of that. poller: None when it
    is for something else than a poll."""

    def __init__(self, line: Line, unit: int | None, poller: Poller | None = None) -> None:
        self.poller = poller
        self._line = line
        self._unit = unit
        self._part = False

    async def __aenter__(self) -> None:
        line, task = self._line, asyncio.current_task()
        self._part = line.owner is task
        if self._part:
            return
        line.waiting.append(self)
        try:
            # Turns are given in the order in which they were asked for.
            await line.turn.acquire()
            while self.missing and line.others < len(line.units) and not all(turn.missing for turn in line.waiting):
                line.waiting.rotate(-1)
                line.turn.release()
                await line.turn.acquire()
        finally:
            line.waiting.remove(self)
        line.owner = task

    @property
    def missing(self) -> bool:
        """It will probably take a time-out."""
        return self._unit in self._line.missing

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._part:
            self._line.owner, self._line.others = None, 0 if self.missing else self._line.others + 1
            self._line.turn.release()


def address(unit: int | None) -> str:
    """What makes a unit of a chain listen, and all others not (L945)."""
    return "" if unit is None else f"%{unit}\r"
