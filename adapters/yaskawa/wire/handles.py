"""The Ethernet handles of a controller that an interrupted connection leaves occupied (L1775-1778).

A cable that is pulled ends a connection for the host alone: the controller keeps its handle, and after four such losses
none of the eight is free. After a reconnect the handles of the last connection are therefore closed. They are known by
letter, address and port of the host. Other handles of this host may belong to another client and are closed only while
so few are free that the next connection would be refused.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from adapters.contract import NULL_LOG
from adapters.yaskawa.wire.exchange import SmcCommandRefused
from adapters.yaskawa.wire.session import CommandSession
from orchestrator.model.errors import ControllerFault

LETTERS = "ABCDEFGH"
# From `_IHh2` of a connection that a host has opened, by UDP or TCP, to what closes it (L5884-5906)
CLOSING = {1: -1, 2: -2}
LEAST_FREE = 2  # handles: one for stops, and one for another client


@dataclass(frozen=True, slots=True)
class OpenHandle:
    """A handle that a host has opened. address, port: of the host. kind: `_IHh2`."""

    letter: str
    address: int
    port: int
    kind: int


class HandleCleaner:
    """Closes the handles that lost connections of this adapter have left. It outlives the connections."""

    def __init__(self) -> None:
        self.log = NULL_LOG
        self._last: frozenset[OpenHandle] = frozenset()
        self._before: frozenset[OpenHandle] = frozenset()

    async def close_stale_handles(self, session: CommandSession) -> None:
        """Close what the last connection has left occupied. `session` is the only handle of the new connection so far.

        Raises `LinkClosed`, `ControllerFault`."""
        try:
            own, free, handles = await _read_handles(session)
        except SmcCommandRefused as refusal:
            self.log.warning(f"handles are not listed: {refusal.text}")
            return
        other_handles = [
            handle for handle in handles.values() if handle.letter != own.letter and handle.address == own.address
        ]
        stale = [handle for handle in other_handles if handle in self._last]
        if free + len(stale) < LEAST_FREE:
            stale = other_handles
        for handle in stale:
            self.log.warning(
                "a handle that a lost connection has left is closed", handle=handle.letter, port=handle.port
            )
            try:
                await session.send_command(f"IH{handle.letter}=>{CLOSING[handle.kind]}")
            except SmcCommandRefused as refusal:
                self.log.warning(f"handle {handle.letter} stays: {refusal.text}")
        self._last = frozenset((own,))
        self._before = frozenset(handles.values()) - frozenset(stale)

    async def note_second_handle(self, session: CommandSession) -> None:
        """Note the handle that was opened since `close_stale_handles`."""
        try:
            own, _, handles = await _read_handles(session)
        except SmcCommandRefused:
            return
        new_handles = [
            handle for handle in handles.values() if handle not in self._before and handle.address == own.address
        ]
        if len(new_handles) == 1:
            self._last |= frozenset(new_handles)


async def _read_handles(session: CommandSession) -> tuple[OpenHandle, int, Mapping[str, OpenHandle]]:
    """Return the handle of `session`, the number of free ones, and all that hosts have opened, by letter."""
    operands = [f"_IH{letter}{item}" for letter in LETTERS for item in range(3)]
    number, *values = await session.read_many(["_IA3", *operands])
    if not 0 <= number < len(LETTERS):
        raise ControllerFault(
            "garbage",
            f"the controller names handle {number:g} as its own; handles are 0 to {len(LETTERS) - 1}",
            "check the cable; does another program print on this handle?",
        )
    rows: Sequence[tuple[int, ...]] = [tuple(map(int, values[at : at + 3])) for at in range(0, len(values), 3)]
    handles = {letter: OpenHandle(letter, *row) for letter, row in zip(LETTERS, rows, strict=True) if row[2] in CLOSING}
    own = handles.get(LETTERS[int(number)]) or OpenHandle(LETTERS[int(number)], 0, 0, 0)
    return own, sum(row[2] == 0 for row in rows), handles
