"""What the steps of a job need of a fleet: axes, controllers and trigger wires."""

from collections.abc import Collection, Iterable, Sequence

from orchestrator.model.fleet import Fleet, TriggerWire
from orchestrator.model.names import controller_of
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.tree import iterate_steps


def find_axes(fleet: Fleet, steps: Iterable[Step]) -> list[str]:
    """Axes that steps move, switch or set: those that their job must lease. Raises `UnknownName`."""
    return list(dict.fromkeys(axis for step in iterate_steps(steps) for axis in step.find_axes(fleet)))


def find_needed_controllers(fleet: Fleet, steps: Sequence[Step]) -> frozenset[str]:
    """Controllers that no other job may use meanwhile: those of its axes, those whose outputs it switches on the way,
    and those whose outputs start its members by a trigger line. Raises `UnknownName`."""
    moved_controllers, outputs, triggered_controllers = set[str](), set[str](), set[str]()
    for step in iterate_steps(steps):
        if step.moves and not step.searches:
            moved_controllers |= {controller_of(axis) for axis in step.find_axes(fleet)}
        triggered_controllers |= {controller_of(output) for output in step.trigger_outputs}
        outputs |= set(step.switched_outputs)
    drivers = {controller_of(wire.from_) for wire in find_wires(fleet, moved_controllers, outputs)}
    return frozenset({controller_of(axis) for axis in find_axes(fleet, steps)} | drivers | triggered_controllers)


def find_wires(fleet: Fleet, moved: Collection[str], outputs: Collection[str]) -> list[TriggerWire]:
    """The wires that matter for a job. moved: controllers that it moves. outputs: those that it switches."""

    def matters(wire: TriggerWire) -> bool:
        return wire.from_ in outputs or any(controller_of(end) in moved for end in wire.to)

    return [wire for wire in fleet.wiring if matters(wire)]
