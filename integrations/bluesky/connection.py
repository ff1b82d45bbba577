"""One connection to a fleet for all its devices, opened in the event loop of the RunEngine by the first one."""

import asyncio
import os

from integrations.bluesky.moves import FleetMoves
from integrations.bluesky.readings import PlaceReader
from tutti import Tutti

ROUTER = "tcp/127.0.0.1:7447"


class TuttiConnection:
    """A connection that devices share; each RunEngine has its own, because each has an event loop of its own.

    connect: the router, as `tcp/HOST:PORT`; without it `TUTTI_CONNECT` of the environment, else this computer. fleet:
    its name; None: the only one on the bus. actor: for journals and logs. name: of the live jobs in which axes move.
    """

    def __init__(
        self, connect: str | None = None, fleet: str | None = None, *, actor: str = "bluesky", name: str = "bluesky"
    ) -> None:
        self.connect = connect or os.environ.get("TUTTI_CONNECT") or ROUTER
        self._tutti = Tutti(self.connect, fleet, actor=actor)
        self._opening: asyncio.Task[Tutti] | None = None
        self.reader = PlaceReader()
        self.moves = FleetMoves(self.open, name)

    def __repr__(self) -> str:
        return f"<TuttiConnection {self.connect}>"

    async def open(self) -> Tutti:
        """The connected client; the first call connects. Raises `RouterUnreachable`, and `Refusal` with code `no-fleet`
        or `which-fleet`."""
        if self._opening is None or (self._opening.done() and self._opening.exception() is not None):
            self._opening = asyncio.get_running_loop().create_task(self._tutti.open())
        return await asyncio.shield(self._opening)

    async def close(self) -> None:
        """Stop what moves for its devices, and disconnect. May be called twice."""
        self.reader.close()
        await self.moves.close()
        await self._tutti.close()
        self._opening = None
