"""The plan of a job: what it would do if it began now, in named parts. Decision 0025 states what belongs to it."""

import asyncio
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import NamedTuple

from orchestrator.bus.base import BusError
from orchestrator.coordinator.fleet.positions import format_position
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.jobs.needs import find_wires
from orchestrator.coordinator.jobs.start_places import StartPlaces
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet, Permit
from orchestrator.model.jobs.job import Job
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.numbers import format_ns
from orchestrator.model.operation.approval import JobPlan
from orchestrator.model.positions.resolve import PositionResolver
from orchestrator.model.state import AxisState, ControllerState
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.numbers import number_step
from orchestrator.model.steps.order import StepOrder
from orchestrator.model.steps.tree import find_digests, iterate_steps
from orchestrator.model.units import format_quantity
from orchestrator.model.virtual_maps import list_inner_groups
from orchestrator.plan.virtual_moves import group_virtual

STEPS_AT_ONCE = 200  # that are looked at before other work gets its turn


class PlannedJob(NamedTuple):
    """A job as it would run. steps: what is left of it, each written step once, with quantities for names of positions.
    used: the values of these, by position and axis."""

    job: Job
    repeat: int
    from_step: int
    steps: Sequence[Step]
    used: Mapping[str, Mapping[str, str]]


async def resolve_job(job: Job, repeat: int, from_step: int, resolver: PositionResolver) -> PlannedJob:
    """A job as it would run with the positions of `resolver`. Raises `Refusal`."""
    steps: list[Step] = []
    for number, step in enumerate(list_written(StepOrder(job.steps, repeat), from_step)):
        if number % STEPS_AT_ONCE == 0:
            await asyncio.sleep(0)
        steps.append(resolver.resolve_step(step))
    return PlannedJob(job, repeat, from_step, steps, resolver.used)


def list_written(order: StepOrder, from_step: int) -> list[Step]:
    """What is left from a step on, each written step once: more passes change nothing of what a plan states."""
    return list({id(step.step): step.step for step in order.list_remaining(from_step)}.values())


async def make_plan(view: FleetView, planned: PlannedJob, since_ns: int | None = None) -> JobPlan:
    """The plan of a job now. since_ns: states of controllers that were queried then or later are used.

    Raises `Refusal` if it cannot be determined: codes `absent`, `offline`, `moving`; and `UnknownName`.
    """
    uses = await _find_uses(view.fleet, planned.steps)
    states = await _query_states(view, sorted(uses.controllers), since_ns)
    parts = await _describe_job(planned)
    for position, values in planned.used.items():
        parts |= {f"position {position} of {axis}": value for axis, value in values.items()}
    # In the order in which changes are named: causes first.
    parts |= _describe_places(view.fleet, uses, states)
    parts |= _describe_entries(view.fleet, uses)
    for name in uses.axes:
        parts |= {f"{limit} of {name}": text for limit, text in _describe_limits(view.fleet.axis(name))}
    parts |= {f"configuration of {name}": state.digest for name, state in states.items()}
    return JobPlan.of(parts)


# What a job uses


@dataclass(slots=True)
class _JobUses:
    """What a job uses, each kind in the order of its steps. absolute: axes with absolute targets. started: axes that
    move, or are counted, from where they stand. virtual: groups of virtual axes. homes_all: it homes the fleet in its
    order."""

    controllers: set[str] = field(default_factory=set[str])
    axes: dict[str, None] = field(default_factory=dict[str, None])
    moved: dict[str, None] = field(default_factory=dict[str, None])
    absolute: dict[str, None] = field(default_factory=dict[str, None])
    started: dict[str, None] = field(default_factory=dict[str, None])
    groups: dict[str, None] = field(default_factory=dict[str, None])
    outputs: dict[str, None] = field(default_factory=dict[str, None])
    frames: dict[str, None] = field(default_factory=dict[str, None])
    virtual: dict[str, None] = field(default_factory=dict[str, None])
    homes_all: bool = False

    def take_step(self, fleet: Fleet, step: Step) -> None:
        """Add what one step uses. Raises `UnknownName`."""
        axes = dict.fromkeys(step.find_axes(fleet))
        self.axes |= axes
        if step.moves:
            self.moved |= axes
        self.absolute |= dict.fromkeys(fleet.find_real_axes(step.absolute_axes))
        for group in group_virtual(fleet, step):
            self.virtual |= dict.fromkeys([group, *list_inner_groups(fleet.virtual, group)])
        self.frames |= dict.fromkeys(step.frames)
        self.groups |= dict.fromkeys(name for name in step.named_axes if name in fleet.groups)
        self.homes_all |= step.uses_whole_fleet
        self.outputs |= dict.fromkeys([*step.switched_outputs, *step.trigger_outputs])
        self.controllers |= set(map(controller_of, step.awaited_inputs))

    def add_controllers(self, fleet: Fleet) -> None:
        """Add the controllers of axes, outputs, trigger lines and permits."""
        names = [*self.axes, *self.outputs, *(permit.input for permit in fleet.permits_of(self.moved).values())]
        drivers = [wire.from_ for wire in find_wires(fleet, {*map(controller_of, self.moved)}, self.outputs)]
        self.controllers |= {*map(controller_of, (*names, *drivers))}


async def _find_uses(fleet: Fleet, steps: Sequence[Step]) -> _JobUses:
    uses, places = _JobUses(), StartPlaces(fleet)
    for number, step in enumerate(iterate_steps(steps)):
        if number % STEPS_AT_ONCE == 0:
            await asyncio.sleep(0)
        uses.take_step(fleet, step)
        uses.started |= dict.fromkeys(places.take_step(step))
    uses.add_controllers(fleet)
    return uses


async def _query_states(view: FleetView, names: list[str], since_ns: int | None) -> dict[str, ControllerState]:
    """The states of controllers now. Raises `Refusal` for one that does not answer, or is offline."""

    async def query_state(name: str) -> ControllerState:
        try:
            state = await view.query_state(name, since_ns)
        except BusError as error:
            raise view.make_absence(name, str(error)) from None
        if state.mode == "offline":
            raise Refusal("offline", f"{name} is offline", "check power and cable", name)
        return state

    return dict(zip(names, await asyncio.gather(*map(query_state, names)), strict=True))


# Parts


async def _describe_job(planned: PlannedJob) -> dict[str, str]:
    """The job itself by the digest of its body, and what is run of it."""
    job = planned.job
    digest = hashlib.sha256(job.model_copy(update={"steps": job.steps[:1]}).to_json())
    for number, step in enumerate(job.steps):
        if number % STEPS_AT_ONCE == 0:
            await asyncio.sleep(0)
        digest.update(step.to_json())
    parts = {"job": f"{job.name!r} of {job.actor}, {len(job.steps)} steps, sha256:{digest.hexdigest()}"}
    if planned.repeat > 1:
        parts["repeat"] = f"{planned.repeat} times"
    if planned.from_step:
        parts["first step"] = str(number_step(planned.from_step))
    points = find_digests(planned.steps)
    return parts | ({"points": ", ".join(points)} if points else {})


def _describe_places(fleet: Fleet, uses: _JobUses, states: Mapping[str, ControllerState]) -> dict[str, str]:
    """Offsets and places of axes where they matter. Raises `Refusal` for the place of a moving axis."""
    parts: dict[str, str] = {}
    for name in uses.axes:
        axis, (controller, short) = fleet.axis(name), split_name(name)
        state = states[controller].axes[short]
        if name in uses.absolute or name in uses.started:
            parts[f"offset of {name}"] = f"{_format_exact(state.offset)} {axis.unit}"
        if name in uses.started:
            parts[f"start of {name}"] = _describe_start(name, axis, state)
    return parts


def _describe_limits(axis: Axis) -> Iterator[tuple[str, str]]:
    limits, unit, soft = axis.limits, axis.unit, axis.soft_limits
    yield "velocity limit", f"{limits.velocity:.15g} {unit}/s"
    yield "acceleration limit", f"{limits.acceleration:.15g} {unit}/s²"
    if limits.jerk is not None:
        yield "jerk limit", f"{limits.jerk:.15g} {unit}/s³"
    if soft is not None:
        yield "range", f"{format_quantity(soft.min, unit)} to {format_quantity(soft.max, unit)}"


def _describe_start(name: str, axis: Axis, state: AxisState) -> str:
    if state.moving or state.homing:
        text = f"axis {name} moves, and the job goes on from where it stands"
        raise Refusal("moving", text, "wait until it is at rest", controller_of(name))
    if not state.referenced:
        return "not referenced"
    # The commanded position: the measured one of a servo axis is never quite at rest.
    return format_position(axis, float(axis.to_position(state.axis_counts) + state.offset))


def _format_exact(value: Fraction) -> str:
    """A number as a decimal if that is exact, otherwise as a fraction."""
    decimal = f"{float(value):.15g}"
    return decimal if Fraction(decimal) == value else str(value)


def _describe_entries(fleet: Fleet, uses: _JobUses) -> dict[str, str]:
    """What else of the fleet file the job depends on: groups and the order of homing, wires, permits."""
    parts = {f"group {name}": ", ".join(fleet.groups[name]) for name in uses.groups}
    # A frame that does not exist is refused when the path is planned.
    parts |= {
        f"frame {name}": fleet.path_frames[name].to_json().decode() for name in uses.frames if name in fleet.path_frames
    }
    parts |= {f"virtual axes {name}": fleet.virtual[name].to_json().decode() for name in uses.virtual}
    if uses.homes_all:
        order = "; ".join(", ".join(fleet.expand_name(name)) for name in fleet.home_order)
        parts["order of homing"] = order or "axis by axis"
    for wire in find_wires(fleet, {*map(controller_of, uses.moved)}, uses.outputs):
        least_us, most_us = wire.delay_us
        name, text = f"wire from {wire.from_}", f"to {', '.join(wire.to)} within {least_us} to {most_us} µs"
        parts[name] = f"{parts[name]}; {text}" if name in parts else text
    return parts | dict(_describe_permits(fleet, fleet.permits_of(uses.moved)))


def _describe_permits(fleet: Fleet, permits: Mapping[str, Permit]) -> Iterator[tuple[str, str]]:
    for name, permit in permits.items():
        level = "active" if permit.value else "not active"
        axes = "the whole fleet" if permit.axes is None else ", ".join(fleet.expand_names(permit.axes))
        settle_text = f" for {format_ns(permit.settle)}" if permit.settle else ""
        yield f"permit {name}", f"{permit.input} {level}{settle_text}, for {axes}"
