"""How stops reach the controller past everything that is under way: by a handle of their own, or on the only one."""

import asyncio
from contextlib import suppress

from adapters.contract import DriverFault
from adapters.yaskawa.smc4000.session import Session, write_each
from orchestrator.link.base import Link, LinkClosed


class StopHandle:
    """A handle for stops alone: written at any moment, its replies read away so that none is ever waited for."""

    def __init__(self, link: Link, timeout_s: float) -> None:
        self._link = link
        self._timeout_s = timeout_s
        self._written = 0
        self._carried_out = 0
        self._asking = asyncio.Lock()
        self._markers = 0
        self._heard = bytearray()
        self._heard_more = asyncio.Event()
        self.open = True
        self._drain = asyncio.get_running_loop().create_task(self._read_away())

    def write(self, *commands: str) -> None:
        """At once. Raises `LinkClosed`."""
        self._written += 1
        write_each(self._link, commands)

    async def carried_out(self) -> None:
        """Until the controller has carried out all that was written. Raises `DriverFault`, `LinkClosed`.

        It takes the commands of one handle in their order, those of two handles as they come: a stop that it has not
        come to yet would halt what the other handle begins meanwhile.
        """
        async with self._asking:
            while self._carried_out < self._written:
                written = self._written
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
                                raise LinkClosed(f"{self._link.place} is closed")
                except TimeoutError:
                    raise DriverFault(
                        "no-answer",
                        f"{self._link.place}: the handle for stops has not answered within {self._timeout_s:g} s",
                        "check power and cable; is another program holding the controller's interpreter?",
                    ) from None
                self._carried_out = written

    async def close(self, goodbye: bytes = b"") -> None:
        if goodbye and self.open:
            with suppress(LinkClosed):
                self._link.write(goodbye)
        self._drain.cancel()
        await self._link.close()

    async def _read_away(self) -> None:
        try:
            while True:
                received = await self._link.read()
                if self._asking.locked():
                    self._heard += received.data
                    self._heard_more.set()
        except LinkClosed:
            return
        finally:
            self.open = False
            self._heard_more.set()


class SharedStops:
    """Stops on the line that carries everything else, from the next character on."""

    open = True

    def __init__(self, session: Session) -> None:
        self._session = session

    def write(self, *commands: str) -> None:
        """At once. Raises `LinkClosed`."""
        self._session.shout(*commands)

    async def carried_out(self) -> None:
        """What comes later on the line is taken later."""

    async def close(self, goodbye: bytes = b"") -> None:
        """The line belongs to the session."""
        del goodbye
