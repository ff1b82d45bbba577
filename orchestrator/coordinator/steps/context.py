"""What a step needs while it runs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.positions import PositionBook
from orchestrator.coordinator.fleet.requests import FencedFields
from orchestrator.coordinator.fleet.zones import ZoneGuard
from orchestrator.model.messages import LeasedRequest, OutputRequest, Reply, raise_first_refusal
from orchestrator.plan.step import ExactTargets

ANSWER_S = 3.0

ProgressCallback = Callable[[float, str], None]
"""Receives the fraction that is done, 0 to 1, and what is being done."""

ReportFields = Mapping[str, object]
"""Fields of the step's report that its kind adds."""


def _ignore_progress(part: float, doing: str) -> None:
    del part, doing


@dataclass(frozen=True, slots=True)
class StepContext:
    """What a step needs while it runs. holder: has the leases of its axes. targets: exact positions of axes. positions:
    those with names. zones: the check against them. begun_ns: when its job began; 0 outside of one."""

    fleet: FleetAccess
    targets: ExactTargets
    positions: PositionBook
    zones: ZoneGuard
    holder: str
    actor: str
    begun_ns: int = 0
    progress: ProgressCallback = _ignore_progress

    @property
    def request_fields(self) -> FencedFields:
        """The fields of each request."""
        return self.fleet.requests.request_fields(self.actor)

    async def request_all(
        self, verb: str, requests: Mapping[str, LeasedRequest | OutputRequest], timeout_s: float = ANSWER_S
    ) -> None:
        """Send a request to each controller. Raises `Refusal`, the first one."""
        raise_first_refusal(await self.fleet.requests.request_all(verb, requests, Reply, timeout_s))
