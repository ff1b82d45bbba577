"""A controller as the bus sees it: its state, its events, its information, its clock."""

from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import cache
from typing import Any

from pydantic import BaseModel, ValidationError

from adapters.contract import Reading
from adapters.controller.clock import clock_mapping, learned_crystal
from adapters.controller.context import Seat
from adapters.controller.events import EventRing
from adapters.controller.fencing import Fence
from adapters.controller.participant import Phase, Ticket
from adapters.controller.status import Condition
from adapters.controller.store import Remembered
from orchestrator.bus.base import Declared, Priority, RequestRefused, Sample
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.fleet import Input, Output
from orchestrator.model.state import (
    AxisEvidence,
    AxisState,
    ClockQuality,
    ClockReply,
    ControllerState,
    Event,
    EventKind,
    EventsRequest,
    Fault,
    Info,
    Mode,
)

CLOCK_EVERY = 10  # states between two puts of the mapping, which moves slowly
_NONE = Fraction(0)


class Presenter:
    """Builds and puts what others may know of one controller.

    ticket: gives the step that it is loaded with; following: whether one is not over yet. holders: who holds axes.
    """

    def __init__(
        self,
        seat: Seat,
        fence: Fence,
        remembered: Remembered,
        condition: Condition,
        ticket: Callable[[], Ticket | None],
        following: Callable[[], bool],
        holders: Callable[[], dict[str, str]],
    ) -> None:
        self._seat = seat
        self._controller, self._config, self._driver = seat.controller, seat.config, seat.driver
        self._bus, self._keys, self._clock = seat.bus, seat.keys, seat.clock
        self._fence = fence
        self._remembered = remembered
        self._condition = condition
        self._ticket = ticket
        self._following = following
        self._holders = holders
        self._events = EventRing(seat.instance)
        self._state_seq = 0
        self.published_ns = 0

    async def serve(self) -> list[Declared]:
        """Answer for the last state, for missed events, and for who the controller is."""
        keys, bus = self._keys, self._bus
        return [
            await bus.serve(keys.state(self._controller), self._answer_state),
            await bus.serve(keys.event(self._controller), self._answer_events),
            await bus.serve(keys.info(self._controller), self._answer_info),
            await bus.serve(keys.clock(self._controller), self._answer_clock),
        ]

    async def _answer_clock(self, _: Sample) -> bytes:
        mapping, crystal = self._mapping(), self._driver.crystal()
        return ClockReply(
            controller=self._controller,
            start_classes=list(self._driver.capabilities.start_classes),
            mapping=None if mapping is None else clock_mapping(self._controller, mapping, self._clock.now_ns()),
            crystal=None if crystal is None else learned_crystal(crystal, self._clock.now_ns()),
        ).to_json()

    # State

    def mode(self) -> Mode:
        """What the controller is doing, in one word."""
        condition = self._condition
        if condition.reading is None:
            return "offline"
        ticket = self._ticket()
        if ticket is not None:
            return "moving" if ticket.phase in (Phase.RELEASED, Phase.MOVING) else ticket.phase.value
        if condition.homing:
            return "homing"
        if condition.jogging:
            return "jogging"
        if any(axis.moving for axis in condition.reading.axes.values()):
            return "stopping" if self._clock.now_ns() < condition.stopping_until_ns else "moving"
        unseen = condition.reading.at_ns < condition.stopped_ns and self._clock.now_ns() < condition.stopping_until_ns
        if unseen or self._following():
            return "stopping"  # nobody has seen yet that it rests
        return "fault" if condition.faults else "idle"

    def state(self) -> ControllerState:
        """The full state as it is known now."""
        reading, ticket = self._condition.reading, self._ticket()
        return ControllerState(
            controller=self._controller,
            instance=self._seat.instance,
            seq=self._state_seq,
            utc=self._clock.utc(),
            fleet_ns=self._fleet_ns(),
            read_fleet_ns=None if reading is None else self._in_fleet_time(reading.at_ns),
            mode=self.mode(),
            axes={name: self._axis(name, reading) for name in self._config.axes},
            inputs=_named(self._config.inputs, reading.inputs) if reading else {},
            outputs=_named(self._config.outputs, reading.outputs) if reading else {},
            faults=self._condition.faults,
            clock=self._clock_quality(),
            estop=self._fence.latch,
            epoch=self._fence.epoch,
            digest=self._config.digest,
            job=ticket.job if ticket else None,
            step=ticket.step if ticket else None,
            leases=self._holders(),
            event_seq=self._events.last_seq,
        )

    def publish(self) -> ControllerState:
        """Put the state, which it gives, and now and then the clock mapping."""
        self._state_seq += 1
        self.published_ns = self._clock.now_ns()
        state = self.state()
        self._bus.put(self._keys.state(self._controller), state.to_json(), Priority.STATE)
        mapping = self._mapping()
        if mapping is not None and self._state_seq % CLOCK_EVERY == 0:
            shown = clock_mapping(self._controller, mapping, self._clock.now_ns())
            self._bus.put(self._keys.clock(self._controller), shown.to_json(), Priority.STATE)
        return state

    def _axis(self, name: str, reading: Reading | None) -> AxisState:
        axis = self._config.axes[name]
        offset = self._remembered.now.offsets.get(name, _NONE)
        if reading is None:
            return AxisState(
                position=0.0,
                commanded=0.0,
                velocity=0.0,
                motor_position=0.0,
                raw_counts=0.0,
                commanded_counts=0,
                offset=offset,
                unit=axis.unit,
                moving=self._condition.may_move,
                enabled=False,
                referenced=False,
            )
        now = reading.axes[name]
        motor = axis.to_unit(now.actual_counts)
        shift = float(offset) if offset else 0.0
        return AxisState(
            position=axis.wrapped(motor + shift),
            commanded=axis.wrapped(axis.to_unit(now.commanded_counts) + shift),
            velocity=axis.to_unit(now.velocity_counts_s),
            motor_position=motor,
            raw_counts=now.actual_counts,
            commanded_counts=now.commanded_counts,
            offset=offset,
            unit=axis.unit,
            moving=now.moving,
            homing=name in self._condition.homing,
            enabled=now.enabled and name not in self._condition.braked,
            referenced=self._condition.referenced[name],
            limit=now.limit,
            fault=next((fault.code for fault in reading.faults if fault.axis == name), None),
        )

    def _mapping(self) -> TickMapping | None:
        return self._driver.mapping() if self._condition.reading is not None else None

    def _clock_quality(self) -> ClockQuality | None:
        mapping = self._mapping()
        if mapping is None:
            return None
        now_ns = self._clock.now_ns()
        return ClockQuality(
            bound_ns=mapping.bound_at_ns(now_ns), age_ns=max(0, now_ns - mapping.host_at_ns), samples=mapping.samples
        )

    def _fleet_ns(self) -> int | None:
        return self._in_fleet_time(self._clock.now_ns())

    def _in_fleet_time(self, host_ns: int) -> int | None:
        scale = self._seat.scale()
        return None if scale is None else scale.fleet_ns(host_ns)

    # Events

    def emit(
        self,
        kind: EventKind,
        text: str,
        *,
        ticket: Ticket | None = None,
        evidence: Mapping[str, AxisEvidence] | None = None,
        fault: Fault | None = None,
    ) -> None:
        """Put an event, keep it for those who miss it, and log it; a fault with the last bytes on the link."""
        event = Event(
            controller=self._controller,
            instance=self._seat.instance,
            seq=self._events.last_seq + 1,
            utc=self._clock.utc(),
            fleet_ns=self._fleet_ns(),
            kind=kind,
            text=text,
            job=ticket.job if ticket else None,
            step=ticket.step if ticket else None,
            evidence=dict(evidence or {}),
            fault=fault,
        )
        self._bus.put(self._keys.event(self._controller), self._events.add(event), Priority.EVENT)
        about = {"controller": self._controller, "kind": kind, "job": event.job, "step": event.step}
        self._seat.log.info(text, **about, epoch=self._fence.epoch)
        if kind in ("fault", "failed", "offline"):
            self._seat.log.info(
                "the last bytes on the link", controller=self._controller, trace=self._seat.trace.tail_text()
            )

    # Answers

    async def _answer_state(self, _: Sample) -> bytes:
        return self.state().to_json()

    async def _answer_events(self, sample: Sample) -> bytes:
        try:
            request = EventsRequest.model_validate_json(sample.payload)
        except ValidationError as error:
            raise RequestRefused(explain(error)) from None
        return self._events.after(request.after).to_json()

    async def _answer_info(self, _: Sample) -> bytes:
        identity, capabilities = self._condition.identity, self._driver.capabilities
        return Info(
            controller=self._controller,
            instance=self._seat.instance,
            make=self._seat.make.name,
            model=identity.model if identity else "",
            firmware=identity.firmware if identity else "",
            serial=identity.serial if identity else "",
            axes={name: axis.to_plain() for name, axis in self._config.axes.items()},
            start_classes=list(capabilities.start_classes),
            orders=list(capabilities.orders),
            independent_axes=capabilities.independent_axes,
            costs=capabilities.costs,
            digest=self._config.digest,
            options_schema=_schema(self._seat.make.options),
        ).to_json()


@cache
def _schema(options: type[BaseModel]) -> dict[str, Any]:
    """The JSON Schema of a make's options, which takes pydantic some milliseconds each time."""
    return options.model_json_schema()


def _named(points: Mapping[str, Input] | Mapping[str, Output], levels: Mapping[int, bool]) -> dict[str, bool]:
    """Named inputs or outputs, true where active."""
    return {name: levels.get(each.number, False) == (each.active == "high") for name, each in points.items()}


def explain(error: ValidationError) -> str:
    """The first thing that is wrong with a payload, for the one who sent it."""
    first = error.errors()[0]
    return f"{'.'.join(map(str, first['loc'])) or 'payload'}: {first['msg']}"
