"""Transmission of stops, bypassing everything that is under way: over a separate handle, or over the only one."""

import asyncio
from contextlib import suppress

from adapters.yaskawa.wire.session import CommandSession, write_each
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import ControllerFault


class StopHandle:
    """A handle for stops alone: written at any moment; its replies are read and discarded, so that no caller waits for
    them."""

    def __init__(self, link: Link, timeout_s: float) -> None:
        self._link = link
        self._timeout_s = timeout_s
        self._written = 0
        self._executed = 0
        self._query_lock = asyncio.Lock()
        self._markers = 0
        self._heard = bytearray()
        self._heard_more = asyncio.Event()
        self.open = True
        self._drain = asyncio.get_running_loop().create_task(self._discard_replies())

    def write_stop(self, *commands: str) -> None:
        """Write at once. Raises `LinkClosed`."""
        self._written += 1
        write_each(self._link, commands)

    async def wait_until_executed(self) -> None:
        """Wait until the controller has executed everything that was written. Raises `ControllerFault`, `LinkClosed`.

        The controller executes the commands of one handle in their order, those of two handles in the order of arrival:
        a stop that is still queued would halt a motion that the other handle begins meanwhile.
        """
        async with self._query_lock:
            while self._executed < self._written:
                written_count = self._written
                self._markers += 1
                marker = f"<{self._markers}>"
                self._heard.clear()
                write_each(self._link, [f'MG "{marker}"'])
                try:
                    async with asyncio.timeout(self._timeout_s):
                        while marker.encode() + b"\r\n:" not in self._heard:
                            self._heard_more.clear()
                            await self._heard_more.wait()
                            if not self.open:
                                raise LinkClosed(f"{self._link.endpoint} is closed")
                except TimeoutError:
                    raise ControllerFault(
                        "no-answer",
                        f"{self._link.endpoint}: the handle for stops has not answered within {self._timeout_s:g} s",
                        "check power and cable; does another program occupy the controller's interpreter?",
                    ) from None
                self._executed = written_count

    async def close(self, goodbye: bytes = b"") -> None:
        if goodbye and self.open:
            with suppress(LinkClosed):
                self._link.write(goodbye)
        self._drain.cancel()
        await self._link.close()

    async def _discard_replies(self) -> None:
        try:
            while True:
                chunk = await self._link.read()
                if self._query_lock.locked():
                    self._heard += chunk.data
                    self._heard_more.set()
        except LinkClosed:
            return
        finally:
            self.open = False
            self._heard_more.set()


class SharedStops:
    """Stops on the line that carries all other traffic, from the next character on."""

    open = True

    def __init__(self, session: CommandSession) -> None:
        self._session = session

    def write_stop(self, *commands: str) -> None:
        """Write at once. Raises `LinkClosed`."""
        self._session.write_at_once(*commands)

    async def wait_until_executed(self) -> None:
        """Do nothing: the controller executes later commands of the line later."""

    async def close(self, goodbye: bytes = b"") -> None:
        """Do nothing: the line belongs to the session."""
        del goodbye
