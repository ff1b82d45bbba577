"""What the controller has understood of the moves of a chain, queried after their loads."""

import asyncio
from collections.abc import Callable, Mapping, Sequence

from adapters.shrc203.chain_axis import ChainAxis, is_answered
from adapters.shrc203.wire.replies import COMMAND, REFUSALS, parse_entries, pulse_list
from adapters.shrc203.wire.reply_queue import ShrcLine
from adapters.shrc203.wire.session import ShrcSession


class LoadReadback:
    """The queries of one chain. report: called with what is loaded instead of a move."""

    def __init__(
        self,
        session: ShrcSession,
        controllable: Sequence[int],
        axes: Mapping[int, ChainAxis],
        report: Callable[[str], None],
    ) -> None:
        self._session = session
        self._controllable = controllable
        self._axes = axes
        self._report = report

    def query_loads(self, thread: ChainAxis) -> None:
        """Query the contents of the last loads, after the last of them; the reply arrives before the moves begin, or
        soon after. Only distances are queried: a command with its speeds would take too long to transmit."""
        if len(self._controllable) == 1:
            # There a distance of a few pulses would read like a completion line.
            # of the present load: the next one may be written before the reply
            name, command = thread.name, thread.command
            self._session.send_command("?:CMD", COMMAND).add_done_callback(
                lambda reply: self._compare_line(reply, name, command)
            )
        elif all(
            other_thread.load is None or is_answered(other_thread.load)
            for other_thread in self._axes.values()
            if other_thread is not thread
        ):
            distances = {
                number: axis_thread.moves[axis_thread.loaded - 1].distance for number, axis_thread in self._axes.items()
            }
            self._session.send_command("?:MPW", pulse_list(len(self._controllable))).add_done_callback(
                lambda reply: self._compare_distances(reply, distances)
            )

    def _compare_line(self, reply: "asyncio.Future[ShrcLine]", name: str, command: str) -> None:
        if _has_reply(reply) and reply.result().text.upper() != command:
            self._report(f"axis {name}: sent {command!r}, the controller has understood {reply.result().text!r}")

    def _compare_distances(self, reply: "asyncio.Future[ShrcLine]", meant: Mapping[int, int]) -> None:
        """Compare the loaded distances. A move that has already begun, and left the prebuffer, is checked by its final
        position."""
        if not _has_reply(reply):
            return
        entries = dict(zip(self._controllable, parse_entries(reply.result().text), strict=True))
        for number, distance in meant.items():
            if entries[number] not in (None, distance):
                self._report(
                    f"axis {self._axes[number].name}: {entries[number]} pulses are loaded instead of {distance}"
                )


def _has_reply(query: "asyncio.Future[ShrcLine]") -> bool:
    """Return whether a reply has arrived; a query that was garbled in transit is refused."""
    return is_answered(query) and query.result().text not in REFUSALS
