"""Access to the fleet for the coordinator's parts: what is known of it, how it is commanded, and when it may move."""

from dataclasses import dataclass

from orchestrator.bus.log import ProcessLog
from orchestrator.clock.base import Clock
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.fleet.certificates import CertificateEnds
from orchestrator.coordinator.fleet.permits import PermitMonitor
from orchestrator.coordinator.fleet.requests import MemberRequests
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.messages import Reply, StopMode, StopRequest


@dataclass(frozen=True, slots=True)
class FleetAccess:
    """The view of the fleet, requests to its controllers, its permits, the ends of its certificates, and the
    coordinator's clock, log and tasks."""

    view: FleetView
    requests: MemberRequests
    permits: PermitMonitor
    certificates: CertificateEnds
    clock: Clock
    log: ProcessLog
    tasks: TaskOwner

    async def stop_members(self, members: list[str], mode: StopMode, actor: str, reason: str) -> None:
        """Stop controllers, all at once. A stop is repeated until it is answered; a refusal is logged."""
        requests = {
            member: StopRequest(request_id=self.requests.new_id(), actor=actor, mode=mode, reason=reason)
            for member in members
        }
        replies = await self.requests.repeat_all("stop", requests, Reply)
        for member, reply in replies.items():
            if reply.refused is not None:
                self.log.warning(f"stop: {reply.refused.text}", controller=member)
