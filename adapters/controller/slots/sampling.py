"""Positions that a controller records by itself during a step: begun before the step is armed, fetched at rest."""

from adapters.abilities import SamplingDriver
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.status import ControllerStatus
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import BeginSampling, SamplesTaken, SamplingBegun, TakeSamples
from orchestrator.model.steps.numbers import name_step


class SampleCollection:
    """The samples of one controller."""

    def __init__(self, context: ControllerContext, status: ControllerStatus, steps: LoadedSteps) -> None:
        self._context = context
        self._driver = context.driver if isinstance(context.driver, SamplingDriver) else None
        self._status = status
        self._steps = steps
        self._recorded_for: tuple[str, int] | None = None

    async def begin(self, request: BeginSampling) -> SamplingBegun:
        """Have the controller record. Raises `Refusal`."""
        self._require_rest()
        self._recorded_for = None
        if self._driver is None:
            raise Refusal("no-sampling", "this make cannot record positions by itself", "remove `record` from the step")
        plan = await self._driver.begin_sampling(request.axes, request.period_ns, request.seconds)
        self._recorded_for = request.job, request.step
        return SamplingBegun(period_ns=plan.period_ns, fetch_ns=plan.fetch_ns)

    async def take(self, request: TakeSamples) -> SamplesTaken:
        """Fetch what was recorded for the step. Raises `Refusal`."""
        if self._driver is None or self._recorded_for != (request.job, request.step):
            raise Refusal("no-samples", f"nothing was recorded for job {request.job} {name_step(request.step)}", "")
        self._require_rest()
        self._recorded_for = None
        samples, scale = await self._driver.take_samples(), self._context.require_scale()
        return SamplesTaken(
            fleet_ns=[scale.to_fleet_ns(at_ns) for at_ns in samples.at_ns],
            bound_ns=samples.bound_ns
            + max((scale.bound_at_ns(at_ns) for at_ns in (*samples.at_ns[:1], *samples.at_ns[-1:])), default=0),
            counts={axis: list(counts) for axis, counts in samples.counts.items()},
        )

    def _require_rest(self) -> None:
        moving_axes = [name for name, axis in self._status.require_online().axes.items() if axis.moving]
        if moving_axes or self._steps.has_step:
            activity = f"axis {moving_axes[0]} is moving" if moving_axes else "a step is loaded"
            raise Refusal("moving", activity, "wait for the end of the motion")
