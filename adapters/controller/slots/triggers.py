"""What outputs with triggers did in a step, fetched from the controller after it; and positions that it latches."""

from collections.abc import Callable, Mapping

from adapters.abilities import LatchDriver, TriggerDriver
from adapters.contract import SwitchedOutput
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.fleet import FleetScale
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import (
    LatchReply,
    LatchRequest,
    LeasedRequest,
    TakeTriggers,
    TriggerEdges,
    TriggersTaken,
)

REST_NS = 5 * NS_PER_S  # for which a controller is waited for that still brakes: some answer only at rest
LOOK_NS = 20 * NS_PER_MS


class TriggerCollection:
    """The triggers of one controller."""

    def __init__(self, context: ControllerContext, status: ControllerStatus, steps: LoadedSteps) -> None:
        self._context = context
        self._driver = context.driver if isinstance(context.driver, TriggerDriver) else None
        self._clock = context.clock
        self._status = status
        self._steps = steps
        self._edges: dict[str, TriggerEdges] = {}

    async def take(self, request: TakeTriggers) -> TriggersTaken:
        """Fetch what happened in the last step, and return a part of it: the first one, or a later one of the same
        step. Raises `Refusal`."""
        if not request.first:
            self._edges = await self._fetch()
        end = request.first + request.limit
        return TriggersTaken(
            outputs={output: _cut_part(edges, request.first, end) for output, edges in self._edges.items()},
            more=any(len(edges.earliest_ns) > end for edges in self._edges.values()),
        )

    async def _fetch(self) -> dict[str, TriggerEdges]:
        until_ns = self._clock.now_ns() + REST_NS
        while any(axis.moving for axis in self._status.require_online().axes.values()):
            if self._clock.now_ns() > until_ns:
                raise Refusal("moving", "an axis is still moving", "wait for the end of the motion")
            await sleep_ns(self._clock, LOOK_NS)
        if self._steps.has_step:
            raise Refusal("busy", "a step is loaded", "wait for its end")
        switched_outputs: Mapping[str, SwitchedOutput] = {}
        if self._driver is not None:
            switched_outputs = await self._driver.take_triggers()
        scale = self._context.require_scale()
        return {output: _to_fleet(switched_output, scale) for output, switched_output in switched_outputs.items()}


class LatchControl:
    """The position latches of one controller. require_idle: raises `Refusal` unless the requester may use its axes, and
    no step is loaded."""

    def __init__(self, context: ControllerContext, require_idle: Callable[[LeasedRequest], None]) -> None:
        self._context = context
        self._driver = context.driver if isinstance(context.driver, LatchDriver) else None
        self._config = context.config
        self._require_idle = require_idle

    async def latch(self, request: LatchRequest) -> LatchReply:
        """Arm a latch, and answer when it has captured a position. Raises `Refusal`."""
        self._require_idle(request)
        point = self._config.inputs.get(request.input)
        if point is None:
            input_names = ", ".join(self._config.inputs) or "none"
            raise Refusal("unknown-input", f"no input {request.input}; inputs: {input_names}", "correct the name")
        axis = request.axes[0]
        if self._driver is None:
            text = f"axis {axis}: this make has no position latch"
            raise Refusal("no-latch", text, "use an axis of an SMC-4000, or of a CiA 402 drive")
        latch, scale = await self._driver.latch_position(axis, point, request.within_ns), self._context.require_scale()
        earliest_ns, latest_ns = scale.to_fleet_span(latch.span.earliest_ns, latch.span.latest_ns)
        return LatchReply(counts=latch.counts, earliest_ns=earliest_ns, latest_ns=latest_ns)


def _cut_part(edges: TriggerEdges, first: int, end: int) -> TriggerEdges:
    return TriggerEdges(
        earliest_ns=edges.earliest_ns[first:end], latest_ns=edges.latest_ns[first:end], unknown=edges.unknown
    )


def _to_fleet(switched: SwitchedOutput, scale: FleetScale) -> TriggerEdges:
    spans = [scale.to_fleet_span(edge.earliest_ns, edge.latest_ns) for edge in switched.edges]
    return TriggerEdges(
        earliest_ns=[earliest_ns for earliest_ns, _ in spans],
        latest_ns=[latest_ns for _, latest_ns in spans],
        unknown=switched.unknown,
    )
