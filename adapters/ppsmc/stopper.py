"""The connection that stops go by: commands of one connection are executed in order, those of another beside them."""

import asyncio

from adapters.ppsmc.session import EOL
from orchestrator.link.base import Link, LinkClosed, LinkRefused, OpenLink


class Stopper:
    """A second TCP connection, kept open. Without it (serial port, no client free) stops go by the first alone."""

    def __init__(self, open_link: OpenLink, wanted: bool) -> None:
        self._open_link = open_link
        self._wanted = wanted
        self._link: Link | None = None
        self._reader: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Open it if it should be there and is not."""
        if not self._wanted or self._link is not None:
            return
        try:
            link = self._link = await self._open_link()
        except LinkRefused:
            return
        self._reader = asyncio.get_running_loop().create_task(self._drain(link))

    def write(self, *lines: str) -> int | None:
        """Write at once; the instant, or None when it is not open."""
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

    async def _drain(self, link: Link) -> None:
        """What the unit says here (its greeting, messages) interests nobody; its end does."""
        try:
            while True:
                await link.read()
        except LinkClosed:
            if self._link is link:
                self._link = None
