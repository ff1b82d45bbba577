"""The renewal of served keys: each is declared anew every few seconds, so that all routers know of it.

Zenoh (1.10.2, `unregister_queryable` in `net/routing/hat/router/queries.rs`) strikes a served key from those that a
router passes to new links when the last *other* router stops serving it, although a session of its own serves it still.
After the next loss of the link no request from the other side reaches that session, while samples pass.
"""

# Zenoh's type stubs omit many return types.
# pyright: reportUnknownMemberType=false, reportMissingModuleSource=false

import asyncio
from contextlib import suppress
from functools import partial
from typing import Protocol

import zenoh
from zenoh.handlers import Callback

from orchestrator.bus.zenoh.threads import run_in_thread
from orchestrator.clock.owner import TaskOwner

RENEWAL_S = 5.0
"""For all served keys in turn, evenly spread; 0.6 ms each."""

_CLOSE_S = 0.5


class _Declaration(Protocol):
    stands: bool


class ServiceRenewal:
    """Renews what a session serves, from the first key on until it is closed."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._served: dict[_Declaration, str] = {}
        self._closing = asyncio.Event()
        self._tasks = TaskOwner()

    def add(self, declaration: _Declaration, expression: str) -> None:
        """Renew this one as long as it stands."""
        self._served[declaration] = expression
        if not self._tasks.pending:
            self._tasks.spawn(self._renew_in_turn())

    async def close(self) -> None:
        """End, with the renewal that is in progress: its thread must not be inside Zenoh when the interpreter ends."""
        self._closing.set()
        if pending := self._tasks.pending:
            await asyncio.wait(pending, timeout=_CLOSE_S)

    async def _renew_in_turn(self) -> None:
        while not self._closing.is_set():
            self._served = {declaration: key for declaration, key in self._served.items() if declaration.stands}
            turns = list(self._served)
            for declaration in turns:
                await self._wait(RENEWAL_S / len(turns))
                if declaration.stands and not self._closing.is_set():
                    await run_in_thread("bus-renewal", partial(self._renew, self._served[declaration]))
            if not turns:
                await self._wait(RENEWAL_S)

    async def _wait(self, delay_s: float) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(delay_s):
                await self._closing.wait()

    def _renew(self, expression: str) -> None:
        """Change what is known of the key for an instant: that alone makes a router pass it on again."""
        with suppress(zenoh.ZError):  # the session is being closed
            pulse = self._session.declare_queryable(expression, Callback(_ignore, None, indirect=False), complete=True)
            pulse.undeclare()


def _ignore(query: zenoh.Query) -> None:
    """The declaration that is renewed gets the request as well, and answers."""
    query.drop()
