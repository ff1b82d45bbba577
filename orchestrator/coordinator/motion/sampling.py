"""Positions that controllers record by themselves during a step: begun before it is armed, fetched and published after
it."""

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.fleet.requests import ANSWER_S
from orchestrator.coordinator.motion.planning import StepRequest
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.messages import BeginSampling, SamplesTaken, SamplingBegun, TakeSamples, raise_first_refusal
from orchestrator.model.operation.recording import SampledAxis, StepSamples
from orchestrator.model.report import SamplingReport

BEGIN_S = 10.0  # on a slow serial line, setting up takes a second
MARGIN_S = 0.5  # recorded after the planned end


class StepSampler:
    """The sampling of one step; does nothing for a step without `record`."""

    def __init__(self, services: MotionServices, request: StepRequest) -> None:
        self._services = services
        self._request = request
        self._fetch_ns: dict[str, int] = {}

    async def begin(self, duration_s: float, lead_ns: int) -> None:
        """Have all controllers record. duration_s: planned; lead_ns: until the start, as far as it is known. Raises
        `Refusal`: then none goes on."""
        wanted_sampling = self._request.move.record
        if wanted_sampling is None:
            return
        fleet = self._services.fleet.view.fleet
        seconds = duration_s + 2 * lead_ns / NS_PER_S + MARGIN_S
        requests = {
            member: BeginSampling(
                **self._services.fleet.requests.request_fields(self._request.job.actor),
                job=self._request.job_id,
                step=self._request.index,
                axes=list(axes),
                period_ns=wanted_sampling.period,
                seconds=seconds,
            )
            for member, axes in group_by_controller(fleet.expand_names(wanted_sampling.axes)).items()
        }
        replies = await self._services.fleet.requests.request_all("begin-sampling", requests, SamplingBegun, BEGIN_S)
        raise_first_refusal(replies)
        self._fetch_ns = {member: reply.fetch_ns for member, reply in replies.items()}

    async def take(self) -> SamplingReport | None:
        """Fetch and publish what was recorded; None for a step without sampling. Raises nothing."""
        if not self._fetch_ns:
            return None
        fetch_ns, self._fetch_ns = self._fetch_ns, {}
        requests = {
            member: TakeSamples(
                **self._services.fleet.requests.request_fields(self._request.job.actor),
                job=self._request.job_id,
                step=self._request.index,
            )
            for member in fetch_ns
        }
        timeout_s = ANSWER_S + 2 * max(fetch_ns.values()) / NS_PER_S
        replies = await self._services.fleet.requests.request_all("take-samples", requests, SamplesTaken, timeout_s)
        for member, reply in replies.items():
            if reply.refused is None:
                self._publish(member, reply)
        refusals = [f"{member}: {reply.refused.text}" for member, reply in replies.items() if reply.refused is not None]
        counted_replies = {member: len(reply.fleet_ns) for member, reply in replies.items()}
        return SamplingReport(samples=counted_replies, problem="; ".join(refusals))

    def _publish(self, member: str, reply: SamplesTaken) -> None:
        fleet, axes = self._services.fleet.view.fleet, dict[str, SampledAxis]()
        for name, counts in reply.counts.items():
            axis = fleet.axis(f"{member}.{name}")
            axes[name] = SampledAxis(unit=axis.unit, counts_per_unit=float(axis.counts_per_unit), counts=counts)
        self._services.publisher.publish_samples(
            StepSamples(
                job_id=self._request.job_id,
                step=self._request.index,
                controller=member,
                fleet_ns=reply.fleet_ns,
                bound_ns=reply.bound_ns,
                axes=axes,
            )
        )
