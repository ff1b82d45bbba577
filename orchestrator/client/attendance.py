"""A session of a command that a person waits for: its jobs end with it, whatever ends it.

async with tutti.attend() as attendance:
    entry = await tutti.enqueue_job(job, terms=QueueTerms(session=attendance.session))
    report = await tutti.wait_for_job(entry.id)

Signs of life are published while the context lasts. Without them the adapters stop what the session's jobs move, and
the coordinator cancels the jobs: also when the process is killed or stopped, or its connection is gone.
"""

import asyncio
from collections.abc import Callable
from typing import Self

from orchestrator.bus.base import Priority
from orchestrator.client.connection import FleetConnection
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.owner import TaskOwner
from orchestrator.model.queue import SIGN_PERIOD_NS


class Attendance:
    """One session; use it as a context."""

    def __init__(self, connection: FleetConnection, is_alive: Callable[[], bool] = lambda: True) -> None:
        """is_alive: whether the user is still there, for a process that acts for users elsewhere; while it returns
        false, signs of life are missing."""
        self.session = f"s-{connection.new_id()}"
        self._connection = connection
        self._is_alive = is_alive
        self._signs = TaskOwner()

    async def __aenter__(self) -> Self:
        self._signs.spawn(self._publish_signs())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._signs.cancel_all()

    async def _publish_signs(self) -> None:
        key, payload = self._connection.keys.session(self.session), self._connection.actor.encode()
        while True:
            if self._is_alive():
                self._connection.bus.put(key, payload, Priority.EVENT)
            await asyncio.sleep(SIGN_PERIOD_NS / NS_PER_S)
