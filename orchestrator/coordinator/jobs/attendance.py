"""Sessions of commands that a person waits for: what such a command has begun ends with it.

A client publishes a sign of life for its session. When it is missing, because the command was killed, stopped, or its
terminal or connection is gone, the adapters end its leases (`adapters.controller.leases`), and the leader its jobs.
"""

from collections.abc import Iterable

from orchestrator.bus.base import BusDeclaration, BusSample
from orchestrator.coordinator.jobs.job_run import JobServices
from orchestrator.model.session import SESSION_TIMEOUT_NS


class SessionMonitor:
    """When each session was last seen by this leader."""

    def __init__(self, services: JobServices) -> None:
        self._services = services
        self._seen_ns: dict[str, int] = {}
        self._declared: BusDeclaration | None = None

    async def start(self) -> None:
        services = self._services
        self._declared = await services.bus.subscribe(services.keys.session(), self._receive_sign)

    async def close(self) -> None:
        if self._declared is not None:
            await self._declared.undeclare()

    def find_absent(self, sessions: Iterable[str]) -> set[str]:
        """Those of `sessions` that have been silent for too long. A new one has that time for its first sign."""
        now_ns = self._services.clock.now_ns()
        present = set(sessions)
        self._seen_ns = {each: self._seen_ns.get(each, now_ns) for each in present}
        return {each for each in present if now_ns - self._seen_ns[each] > SESSION_TIMEOUT_NS}

    def _receive_sign(self, sample: BusSample) -> None:
        session = sample.key.rpartition("/")[2]
        if session in self._seen_ns:
            self._seen_ns[session] = self._services.clock.now_ns()
