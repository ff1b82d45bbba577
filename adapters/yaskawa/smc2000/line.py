"""A serial port with one controller or a daisy chain of controllers: opened once, used in turns.

The common state of the controllers of a chain is here: the open link, the present turn, and the address that is
selected for what is written (%A, L945). A stop bypasses all turns: each command is written as a whole, so that it
always begins at the beginning of a command line, and an exchange in progress detects the disturbance by `stops`.
"""

import asyncio
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol

from adapters.yaskawa.wire.session import session_tag
from orchestrator.link.base import Link, LinkClosed, OpenLink

SHARED = "yaskawa serial line"
"""The key of the line in `DriverSetup.shared`."""


class WaitingPoller(Protocol):
    """A session that waits for a turn to poll."""

    def poll_ahead(self) -> str | None:
        """Return what to write for it before its turn has come; None: nothing now."""
        ...


@dataclass(frozen=True, slots=True)
class EarlyPoll:
    """A poll that was written before its turn, while the previous reply was still buffered by the serial adapter.

    plain, marked: the bytes that have arrived for it already, by at_ns.
    """

    poller: WaitingPoller
    sent_ns: int
    at_ns: int = 0
    plain: bytes = b""
    marked: bytes = b""


class SharedSerialLine:
    """One port. Created before any loop runs; every controller of the line joins it when its driver is created.

    selected: the address that receives commands; None: unknown.
    in_step: every requested byte has arrived.
    stops: number of stops written so far.
    loading: bytes written now are taken as program text.
    """

    def __init__(self) -> None:
        self.turn = asyncio.Lock()
        self.owner: asyncio.Task[object] | None = None
        """Lock of the present turn."""
        self.units: set[int | None] = set()
        self.selected: int | None = None
        self.in_step = False
        self.stops = 0
        self.loading = False
        self.half_line = False
        """A download has ended without CR: for controllers that were not addressed, the next address does not begin a
        command line."""
        self.answered = False
        """A controller has answered since the port was opened."""
        self.ahead: EarlyPoll | None = None
        self.missing: set[int | None] = set()
        """Addresses of a chain that did not answer their last request, whichever driver sent it."""
        self.waiting: deque[LineTurn] = deque()
        """In the order in which turns are granted."""
        self.others = 0
        """Turns since the last one of a missing controller: this many pass before the next one, as long as other
        sessions wait."""
        self._opening = asyncio.Lock()
        self._link: Link | None = None
        self._users: set[int | None] = set()
        self._markers = 0
        self._tag = ""

    async def attach_controller(self, unit: int | None, open_link: OpenLink, now_ns: int) -> Link:
        """Return the open port; open it if it is not open yet. Raises `LinkRefused`."""
        async with self._opening:
            if self._link is None:
                self._link = await open_link()
                self._tag = session_tag(now_ns)
                self.selected, self.in_step, self.ahead, self.loading, self.answered = None, False, None, False, False
            self._users.add(unit)
            return self._link

    async def detach_controller(self, unit: int | None) -> None:
        """Detach a controller; the port is closed after the last one."""
        async with self._opening:
            self._users.discard(unit)
            if not self._users and self._link is not None:
                link, self._link = self._link, None
                await link.close()

    def drop_link(self, link: Link) -> None:
        """Drop the closed `link`: the next session opens a new one."""
        if self._link is link:
            self._link = None

    def mark_out_of_step(self) -> None:
        """Mark the line as out of step: unexpected bytes may be under way, and the selected address is unknown."""
        self.in_step, self.selected, self.ahead = False, None, None

    def next_marker(self) -> str:
        """Return a text that no earlier reply can contain."""
        self._markers += 1
        return f"<{self._tag}{self._markers}>"

    def write_at_once(self, link: Link, unit: int | None, commands: Iterable[str], *, unknown: bool = False) -> None:
        """Write commands to a controller at once, bypassing everything that is under way. Raises `LinkClosed`.

        unknown: the previous traffic on this line is unknown.
        """
        self.stops += 1
        # During a download commands would be taken as program text; a backslash ends it (L8205).
        data_end = "\\\r" if self.loading or unknown else ""
        text = data_end + address_command(unit) + "".join(f"{command}\r" for command in commands)
        self.mark_out_of_step()
        try:
            link.write(text.encode("ascii"))
        except LinkClosed:
            self.drop_link(link)
            raise


class LineTurn:
    """`async with`: a turn on the line for the address `unit`; within a turn of the same task, a part of that. poller:
    None for anything but a poll."""

    def __init__(self, line: SharedSerialLine, unit: int | None, poller: WaitingPoller | None = None) -> None:
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
            # Turns are granted in the order of the requests.
            await line.turn.acquire()
            while (
                self.is_missing and line.others < len(line.units) and not all(turn.is_missing for turn in line.waiting)
            ):
                line.waiting.rotate(-1)
                line.turn.release()
                await line.turn.acquire()
        finally:
            line.waiting.remove(self)
        line.owner = task

    @property
    def is_missing(self) -> bool:
        """Whether the turn will probably end by a timeout."""
        return self._unit in self._line.missing

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._part:
            self._line.owner, self._line.others = None, 0 if self.is_missing else self._line.others + 1
            self._line.turn.release()


def address_command(unit: int | None) -> str:
    """Return the command that selects one address of a chain and deselects all others (L945)."""
    return "" if unit is None else f"%{unit}\r"
