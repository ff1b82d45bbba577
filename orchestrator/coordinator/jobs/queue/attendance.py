"""Sessions of commands that a person waits for: what such a command has begun ends with it.

A client publishes a sign of life for its session. When it is missing, because the command was killed, stopped, or its
terminal or connection is gone, the adapters end its leases (`adapters.controller.state.leases`), and the leader its
jobs.
"""

from collections.abc import Iterable
from itertools import chain

from orchestrator.bus.base import BusDeclaration
from orchestrator.bus.session_signs import SessionSigns
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.coordinator.jobs.queue.ends import JobEnds
from orchestrator.coordinator.jobs.queue.journal_tasks import JournalTasks
from orchestrator.coordinator.jobs.queue.queue_gate import COORDINATOR
from orchestrator.coordinator.jobs.queue.register import JobRegister
from orchestrator.coordinator.jobs.run.outcome import JobInterrupted
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JobRecord

SESSION_POLL_NS = 200 * NS_PER_MS  # period of looking for sessions that are over


class SessionMonitor:
    """The sessions of the leader's jobs."""

    def __init__(self, services: JobServices, register: JobRegister, ends: JobEnds, tasks: JournalTasks) -> None:
        self._services = services
        self._register = register
        self._ends = ends
        self._tasks = tasks
        self._signs = SessionSigns(services.clock)
        self._since_ns: dict[str, int] = {}
        self._declared: BusDeclaration | None = None

    async def start(self) -> None:
        services = self._services
        self._declared = await services.bus.subscribe(services.keys.session(), self._signs.receive_sign)

    async def close(self) -> None:
        if self._declared is not None:
            await self._declared.undeclare()

    async def watch_sessions(self) -> None:
        """End the jobs of commands that have ended: of their processes, or the connections to them."""
        services = self._services
        while not services.leadership.over:
            await sleep_ns(services.clock, SESSION_POLL_NS)
            jobs = chain(self._register.running.values(), self._register.waiting.values())
            attended_sessions = [(job.row.session, job.row) for job in jobs if job.row.session is not None]
            absent = self.find_absent(session for session, _ in attended_sessions)
            for session, row in attended_sessions:
                if session in absent:
                    self._tasks.spawn(self._end_unattended, row)

    async def _end_unattended(self, row: JobRecord) -> None:
        reason = f"the command of {row.actor} that waited for it has ended"
        run, waiting_job = self._register.running.get(row.id), self._register.waiting.pop(row.id, None)
        if run is not None:
            await run.interrupt_job(JobInterrupted("cancelled", reason, COORDINATOR))
        elif waiting_job is not None:
            await self._ends.cancel_waiting(waiting_job, reason, COORDINATOR)

    def find_absent(self, sessions: Iterable[str]) -> set[str]:
        """Those of `sessions` that have been silent for too long. A new one has that time for its first sign."""
        now_ns = self._services.clock.now_ns()
        self._since_ns = {session: self._since_ns.get(session, now_ns) for session in set(sessions)}
        return {
            name for name, since_ns in self._since_ns.items() if self._signs.present_until_ns(name, since_ns) < now_ns
        }
