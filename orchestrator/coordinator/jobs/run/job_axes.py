"""The axes of a job: taken before its first step, and lent to persons while it waits for one of them to act."""

from orchestrator.coordinator.fleet.lease_states import LeaseUser
from orchestrator.coordinator.jobs.needs import find_axes
from orchestrator.coordinator.jobs.run.rest import RestMonitor
from orchestrator.coordinator.jobs.run.sequence import StepSequence
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JobRecord


class JobAxes:
    """The axes that job `row` moves, switches or sets. rest: of their controllers."""

    def __init__(self, services: JobServices, row: JobRecord, steps: StepSequence, rest: RestMonitor) -> None:
        self.rest = rest
        self._services = services
        self._row = row
        self._steps = steps

    async def take(self) -> None:
        """Acquire them. Raises `AxesInUse`, `Refusal`; then it has none of them."""
        row, services = self._row, self._services
        axes = find_axes(services.view.fleet, self._steps.list_steps(row.from_step))
        user = LeaseUser(row.id, row.actor, f"job {row.name!r}", row.session or "")
        await services.leases.acquire(user, axes)

    async def give_back(self) -> None:
        """End their lease."""
        await self._services.leases.release(self._row.id)
