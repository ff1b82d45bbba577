"""A controller as it is published on the bus: its state, its events, its information, its clock."""

from collections.abc import Mapping
from dataclasses import dataclass

from adapters.abilities import LearningDriver
from adapters.contract import ControllerReading
from adapters.controller.publishing.axis_states import AxisStates
from adapters.controller.publishing.clock import clock_mapping, learned_crystal, learned_starts
from adapters.controller.publishing.events import EventRing
from adapters.controller.publishing.info import make_info
from adapters.controller.publishing.positions import read_interval, rest_positions
from adapters.controller.publishing.tracing import read_trace_part
from adapters.controller.state.armed_step import ArmedStep
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.fencing import EpochFence
from adapters.controller.state.leases import MotionLeases
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.status import ControllerStatus
from adapters.controller.state.store import PersistentMemory
from orchestrator.bus.base import BusSample, RequestHandler
from orchestrator.bus.decoding import read_request
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.fleet import DigitalInput, DigitalOutput
from orchestrator.model.messages import TraceRequest
from orchestrator.model.state import (
    RESTING_MODES,
    AxisEvidence,
    AxisState,
    ClockQuality,
    ClockReply,
    ControllerEvent,
    ControllerState,
    EventKind,
    EventsRequest,
    FaultReport,
    LinkTotals,
    Mode,
    ReadPosition,
)

STATES_PER_BACKGROUND = 10  # of a controller that moves, between two publications of what changes slowly
BACKGROUND_NS = 10 * NS_PER_S  # at rest


@dataclass(frozen=True, slots=True)
class StateSources:
    """What is published about a controller."""

    fence: EpochFence
    remembered: PersistentMemory
    status: ControllerStatus
    steps: LoadedSteps
    leases: MotionLeases


class StatePublisher:
    """Build and publish everything about one controller."""

    def __init__(self, context: ControllerContext, sources: StateSources) -> None:
        self._context = context
        self._controller, self._config, self._driver = context.controller, context.config, context.driver
        self._learning = context.driver if isinstance(context.driver, LearningDriver) else None
        self._clock = context.clock
        self._fence = sources.fence
        self._remembered = sources.remembered
        self._status = sources.status
        self._axes = AxisStates(context.config.axes, sources.status)
        self._steps = sources.steps
        self._leases = sources.leases
        self._events = EventRing(context.instance)
        self._state_seq = 0
        self._background_ns = 0
        self.published_ns = 0
        self.value_handlers: Mapping[str, RequestHandler] = {
            "state": self._answer_state,
            "event": self._answer_events,
            "info": self._answer_info,
            "clock": self._answer_clock,
            "trace": self._answer_trace,
        }
        """What answers queries for the state, missed events, the controller's information, its clock and its trace, by
        the last word of their keys."""

    async def _answer_clock(self, _: BusSample) -> bytes:
        mapping = self._clock_mapping()
        learns = self._learning
        crystal, latency = (None, None) if learns is None else (learns.crystal_rate(), learns.start_latency())
        return ClockReply(
            controller=self._controller,
            start_classes=list(self._driver.capabilities.start_classes),
            mapping=None if mapping is None else clock_mapping(self._controller, mapping, self._clock.now_ns()),
            crystal=None if crystal is None else learned_crystal(crystal, self._clock.now_ns()),
            unusual_starts=[]
            if latency is None
            else learned_starts(latency, self._steps.past_steps, self._clock.now_ns()),
            widened_ns=0 if latency is None else latency.learned_early_ns + latency.learned_late_ns,
        ).to_json()

    # State

    def current_mode(self) -> Mode:
        """Return the activity of the controller as one mode."""
        status = self._status
        if status.reading is None:
            return "offline"
        armed_step = self._steps.present
        if armed_step is not None:
            return armed_step.mode
        if status.homing:
            return "homing"
        if status.jogging:
            return "jogging"
        if status.probing:
            return "moving"
        if any(axis.moving for axis in status.reading.axes.values()):
            return "stopping" if self._clock.now_ns() < status.stopping_until_ns else "moving"
        unseen = status.reading.at_ns < status.stopped_ns and self._clock.now_ns() < status.stopping_until_ns
        if unseen or self._steps.is_followed:
            return "stopping"  # rest has not been observed yet
        return "fault" if status.faults else "idle"

    @property
    def is_moving(self) -> bool:
        """Whether any axis moves, as far as is known."""
        return self.current_mode() in ("moving", "jogging", "homing", "stopping")

    def answer_state(self) -> ControllerState:
        """Return the full state as known now, to be given out as an answer."""
        self._context.outlet.note_answer(self._controller)
        return self._make_state()

    def _make_state(self) -> ControllerState:
        reading, armed_step = self._status.reading, self._steps.present
        return ControllerState(
            controller=self._controller,
            instance=self._context.instance,
            seq=self._state_seq,
            utc=self._clock.utc(),
            fleet_ns=self._fleet_ns(),
            read_fleet_ns=None if reading is None else self._in_fleet_time(reading.at_ns),
            read_within=read_interval(reading, self._context.scale()),
            mode=self.current_mode(),
            axes={name: self._axis_state(name, reading) for name in self._config.axes},
            inputs=_named_points(self._config.inputs, reading.inputs) if reading else {},
            outputs=_named_points(self._config.outputs, reading.outputs) if reading else {},
            faults=self._status.faults,
            clock=self._clock_quality(),
            estop=self._fence.estop_latch,
            epoch=self._fence.epoch,
            digest=self._config.digest,
            job=armed_step.job if armed_step else None,
            step=armed_step.step if armed_step else None,
            leases=self._leases.holders,
            event_seq=self._events.last_seq,
        )

    def publish_state(self) -> ControllerState:
        """Publish the state, and from time to time what changes slowly; return the state."""
        self._state_seq += 1
        self.published_ns = self._clock.now_ns()
        state = self._make_state()
        if self._is_background_due(state):
            self._background_ns = self.published_ns
            self._publish_background()
        self._context.outlet.offer_state(state)
        return state

    def _is_background_due(self, state: ControllerState) -> bool:
        """Whether to publish what changes slowly: with every tenth state of a controller that moves."""
        is_tenth = self._state_seq % STATES_PER_BACKGROUND == 0 and state.mode not in RESTING_MODES
        return is_tenth or self.published_ns >= self._background_ns + BACKGROUND_NS

    def _publish_background(self) -> None:
        """Publish what changes slowly: the clock mapping, and the bytes on the link."""
        mapping, trace = self._clock_mapping(), self._context.trace
        if mapping is not None:
            clock_state = clock_mapping(self._controller, mapping, self._clock.now_ns())
            self._context.outlet.put_value(self._controller, "clock", clock_state.to_json())
        totals = LinkTotals(controller=self._controller, bytes_out=trace.bytes_out, bytes_in=trace.bytes_in)
        self._context.outlet.put_value(self._controller, "link", totals.to_json())

    def _axis_state(self, name: str, reading: ControllerReading | None) -> AxisState:
        return self._axes.make_state(name, reading, self._remembered.values.offsets.get(name))

    def _clock_mapping(self) -> TickMapping | None:
        return self._driver.clock_mapping() if self._status.reading is not None else None

    def _clock_quality(self) -> ClockQuality | None:
        mapping = self._clock_mapping()
        if mapping is None:
            return None
        now_ns = self._clock.now_ns()
        return ClockQuality(
            bound_ns=mapping.bound_at_ns(now_ns), age_ns=max(0, now_ns - mapping.host_at_ns), samples=mapping.samples
        )

    def _fleet_ns(self) -> int | None:
        return self._in_fleet_time(self._clock.now_ns())

    def _in_fleet_time(self, host_ns: int) -> int | None:
        scale = self._context.scale()
        return None if scale is None else scale.to_fleet_ns(host_ns)

    def _positions_behind(self, ended_step: ArmedStep) -> dict[str, ReadPosition]:
        """Return where the axes of a step that is done were read at rest; none if they have not been read since."""
        reading = self._status.reading
        interval = read_interval(reading, self._context.scale())
        if interval is None or self._steps.reading_is_old:
            return {}
        return rest_positions({name: self._axis_state(name, reading) for name in ended_step.axes}, interval)

    # Events

    def emit_event(
        self,
        kind: EventKind,
        text: str,
        *,
        armed_step: ArmedStep | None = None,
        evidence: Mapping[str, AxisEvidence] | None = None,
        fault: FaultReport | None = None,
    ) -> None:
        """Publish an event, keep it for subscribers that miss it, and log it; a fault with the last bytes on the
        link."""
        event = ControllerEvent(
            controller=self._controller,
            instance=self._context.instance,
            seq=self._events.last_seq + 1,
            utc=self._clock.utc(),
            fleet_ns=self._fleet_ns(),
            kind=kind,
            text=text,
            job=armed_step.job if armed_step else None,
            step=armed_step.step if armed_step else None,
            evidence=dict(evidence or {}),
            positions=self._positions_behind(armed_step) if armed_step is not None and kind == "done" else {},
            fault=fault,
        )
        self._context.outlet.put_event(self._controller, self._events.add_event(event))
        about = {"controller": self._controller, "kind": kind, "job": event.job, "step": event.step}
        self._context.log.info(text, **about, epoch=self._fence.epoch)
        if kind in ("fault", "failed", "offline"):
            self._context.log.info(
                "the last bytes on the link", controller=self._controller, trace=self._context.trace.tail_text()
            )

    # Replies

    async def _answer_state(self, _: BusSample) -> bytes:
        return self.answer_state().to_json()

    async def _answer_events(self, sample: BusSample) -> bytes:
        return self._events.events_after(read_request(EventsRequest, sample, "").after).to_json()

    async def _answer_trace(self, sample: BusSample) -> bytes:
        request = read_request(TraceRequest, sample, "")
        return read_trace_part(self._context, request).to_json()

    async def _answer_info(self, _: BusSample) -> bytes:
        return make_info(self._context, self._status.identity).to_json()


def _named_points(
    points: Mapping[str, DigitalInput] | Mapping[str, DigitalOutput], levels: Mapping[int, bool]
) -> dict[str, bool]:
    """Return named inputs or outputs, true where active."""
    return {name: levels.get(point.number, False) == (point.active == "high") for name, point in points.items()}
