"""What outputs with triggers did in a step, fetched from the controller after it, or while it moves; and positions that
it latches."""

import asyncio
from collections.abc import Callable, Mapping

from adapters.abilities import LatchDriver, ShownTriggerDriver, TriggerDriver
from adapters.contract import SwitchedOutput
from adapters.controller.state.armed_step import ArmedStep, StepPhase
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
from orchestrator.model.steps.numbers import name_step

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
        self._shown = context.driver if isinstance(context.driver, ShownTriggerDriver) else None
        self._shown_step: ArmedStep | None = None
        self._shown_edges: dict[str, TriggerEdges] = {}
        """What was fetched of a step while it moved: it stays as it was given out."""
        self._reading = asyncio.Lock()

    async def take(self, request: TakeTriggers) -> TriggersTaken:
        """Fetch what happened in the last step, or in the one that moves, and return a part of it: the first one, or a
        later one of the same step. Raises `Refusal`."""
        edges = self._edges
        if request.moving:
            edges = await self._read(request)
        elif not request.first:
            edges = self._edges = await self._fetch()
        end = request.first + request.limit
        return TriggersTaken(
            outputs={output: _cut_part(part, request.first, end) for output, part in edges.items()},
            more=any(len(part.earliest_ns) > end for part in edges.values()),
        )

    async def _read(self, request: TakeTriggers) -> dict[str, TriggerEdges]:
        """What happened in the present step up to now."""
        async with self._reading:
            step = self._steps.present
            is_asked_for = step is not None and (step.job, step.step) == (request.job, request.step)
            if step is None or not is_asked_for or step.phase is not StepPhase.MOVING:
                raise Refusal("not-moving", f"job {request.job} {name_step(request.step)} is not being executed", "")
            if self._shown is None:
                raise Refusal("not-shown", "what the controller has switched can be read at its end only", "")
            if not step.is_same(self._shown_step):
                self._shown_step, self._shown_edges = step, {}
            counts = {output: len(edges.earliest_ns) for output, edges in self._shown_edges.items()}
            scale = self._context.require_scale()
            for output, switched_output in (await self._shown.read_triggers(counts)).items():
                new_edges, edges = (
                    _to_fleet(switched_output, scale),
                    self._shown_edges.setdefault(output, TriggerEdges()),
                )
                edges.earliest_ns.extend(new_edges.earliest_ns)
                edges.latest_ns.extend(new_edges.latest_ns)
            return self._shown_edges

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
        all_edges = {output: _to_fleet(switched_output, scale) for output, switched_output in switched_outputs.items()}
        for output, shown_edges in self._shown_edges.items():
            if output in all_edges:
                _keep_shown(all_edges[output], shown_edges)
        return all_edges


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


def _keep_shown(edges: TriggerEdges, shown: TriggerEdges) -> None:
    """Put what was given out in the place of what is known of the same edges at the end of their step."""
    count = len(shown.earliest_ns)
    is_same = 0 < count <= len(edges.earliest_ns) and (
        shown.earliest_ns[0] <= edges.latest_ns[0] and edges.earliest_ns[0] <= shown.latest_ns[0]
    )
    if is_same:
        edges.earliest_ns[:count], edges.latest_ns[:count] = shown.earliest_ns, shown.latest_ns


def _to_fleet(switched: SwitchedOutput, scale: FleetScale) -> TriggerEdges:
    spans = [scale.to_fleet_span(edge.earliest_ns, edge.latest_ns) for edge in switched.edges]
    return TriggerEdges(
        earliest_ns=[earliest_ns for earliest_ns, _ in spans],
        latest_ns=[latest_ns for _, latest_ns in spans],
        unknown=switched.unknown,
    )
