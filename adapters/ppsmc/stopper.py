"""The separate connection for stops: commands of one connection are executed in order, those of another
concurrently."""

import asyncio

from adapters.ppsmc.batches import EOL
from orchestrator.link.base import Link, LinkClosed, LinkRefused, OpenLink


class StopConnection:
    """A second TCP connection, kept open. Without it (serial port, no free client) stops use the first connection
    alone."""

    def __init__(self, open_link: OpenLink, *, wanted: bool) -> None:
        self._open_link = open_link
        self._wanted = wanted
        self._link: Link | None = None
        self._reader: asyncio.Task[None] | None = None

    async def open_connection(self) -> None:
        """Open it if it is wanted and not open."""
        if not self._wanted or self._link is not None:
            return
        try:
            link = self._link = await self._open_link()
        except LinkRefused:
            return
        self._reader = asyncio.get_running_loop().create_task(self._discard_input(link))

    def write_stop(self, *lines: str) -> int | None:
        """Write at once; return the instant, or None when it is not open."""
        if self._link is None:
            return None
        try:
            return self._link.write("".join(line + EOL for line in lines).encode())
        except LinkClosed:
            self._link = None
            return None

    async def close(self) -> None:
        link, self._link = self._link, None
        if self._reader is not None:
            self._reader.cancel()
            self._reader = None
        if link is not None:
            await link.close()

    async def _discard_input(self, link: Link) -> None:
        """Discard everything received here (its greeting, messages); only the end of the connection matters."""
        try:
            while True:
                await link.read()
        except LinkClosed:
            if self._link is link:
                self._link = None
