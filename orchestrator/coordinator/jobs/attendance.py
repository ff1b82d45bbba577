"""Sessions of commands that a person waits for: what such a command has begun ends with it.

A client publishes a sign of life for its session. When it is missing, because the command was killed, stopped, or its
terminal or connection is gone, the adapters end its leases (`adapters.controller.leases`), and the leader its jobs.
"""

from collections.abc import Iterable

from orchestrator.bus.base import BusDeclaration
from orchestrator.bus.session_signs import SessionSigns
from orchestrator.coordinator.jobs.job_run import JobServices


class SessionMonitor:
    """The sessions of the leader's jobs."""

    def __init__(self, services: JobServices) -> None:
        self._services = services
        self._signs = SessionSigns(services.clock)
        self._since_ns: dict[str, int] = {}
        self._declared: BusDeclaration | None = None

    async def start(self) -> None:
        services = self._services
        self._declared = await services.bus.subscribe(services.keys.session(), self._signs.receive_sign)

    async def close(self) -> None:
        if self._declared is not None:
            await self._declared.undeclare()

    def find_absent(self, sessions: Iterable[str]) -> set[str]:
        """Those of `sessions` that have been silent for too long. A new one has that time for its first sign."""
        now_ns = self._services.clock.now_ns()
        self._since_ns = {session: self._since_ns.get(session, now_ns) for session in set(sessions)}
        return {
            name for name, since_ns in self._since_ns.items() if self._signs.present_until_ns(name, since_ns) < now_ns
        }
