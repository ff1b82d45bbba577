"""The steps that are no synchronised motion: enable, home, dwell, output, wait."""

import asyncio
from collections.abc import Mapping

from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.coordinator.members import FencedFields, Members
from orchestrator.coordinator.targets import Refuse, refuse
from orchestrator.coordinator.view import FleetView
from orchestrator.model.duration import format_ns
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import Disable, Dwell, Enable, Home, Move, SetOutput, Step, WaitInput
from orchestrator.model.messages import EnableRequest, HomeRequest, OutputRequest, Reply
from orchestrator.plan.step import Targets

ANSWER_S = 3.0
LOOK_NS = 20 * NS_PER_MS


class PlainSteps:
    """Runs steps on controllers one by one; each raises `Refuse` with the reason if it can not be done."""

    def __init__(self, view: FleetView, members: Members, clock: Clock, targets: Targets) -> None:
        self._view = view
        self._members = members
        self._clock = clock
        self._targets = targets

    async def run(self, step: Step, actor: str) -> None:
        """Run `step` to its end."""
        if isinstance(step, Enable | Disable):
            await self.enable(expand(self._view.fleet, step.axes), isinstance(step, Enable), actor)
        elif isinstance(step, Home):
            await self._home(step, actor)
        elif isinstance(step, Dwell):
            await sleep_ns(self._clock, step.duration)
        elif isinstance(step, SetOutput):
            await self._output(step, actor)
        elif isinstance(step, WaitInput):
            await self._wait(step)

    async def enable(self, axes: list[str], on: bool, actor: str) -> None:
        """Switch the motors of `axes`. Raises `Refuse`."""
        requests = {
            member: EnableRequest(**self._fields(actor), axes=names, on=on)
            for member, names in by_controller(axes).items()
        }
        await self._all("enable", requests, ANSWER_S)

    async def _home(self, step: Home, actor: str) -> None:
        """Home in the order of the list, or of the fleet's `home_order`: one entry after the other."""
        fleet = self._view.fleet
        for entry in homing_order(fleet, step.axes):
            axes = fleet.expand(entry)
            timeout_s = max(fleet.axis(axis).homing.timeout_s for axis in axes) + ANSWER_S
            requests = {
                member: HomeRequest(**self._fields(actor), axes=names) for member, names in by_controller(axes).items()
            }
            for axis in axes:
                self._targets.forget(axis)
            await self._all("home", requests, timeout_s)

    async def _output(self, step: SetOutput, actor: str) -> None:
        controller, _, output = step.output.partition(".")
        request = OutputRequest(**self._fields(actor), output=output, value=step.value)
        await self._all("output", {controller: request}, ANSWER_S)

    async def _wait(self, step: WaitInput) -> None:
        controller, _, name = step.input.partition(".")
        until_ns = self._clock.now_ns() + step.timeout
        while True:
            state = self._view.state(controller)
            if state is not None and not self._view.silent(controller) and state.inputs.get(name) == step.value:
                return
            if self._clock.now_ns() >= until_ns:
                wanted = "active" if step.value else "inactive"
                raise Refuse(
                    "wait-timeout",
                    f"input {step.input} was not {wanted} within {format_ns(step.timeout)}",
                    "",
                    controller,
                )
            await sleep_ns(self._clock, LOOK_NS)

    async def _all(
        self, verb: str, requests: Mapping[str, EnableRequest | HomeRequest | OutputRequest], timeout_s: float
    ) -> None:
        asked = [self._members.ask(member, verb, each, Reply, timeout_s) for member, each in requests.items()]
        for reply in await asyncio.gather(*asked):
            if reply.refused is not None:
                raise refuse(reply.refused)

    def _fields(self, actor: str) -> FencedFields:
        return self._members.fields(actor)


def expand(fleet: Fleet, names: list[str]) -> list[str]:
    """The axes that a list of axes, groups and controllers stands for, each once, in order."""
    return list(dict.fromkeys(axis for name in names for axis in fleet.expand(name)))


def by_controller(axes: list[str]) -> dict[str, list[str]]:
    """Axis names of each controller, without its own name before them."""
    found: dict[str, list[str]] = {}
    for axis in axes:
        controller, _, name = axis.partition(".")
        found.setdefault(controller, []).append(name)
    return found


def homing_order(fleet: Fleet, axes: list[str] | None) -> list[str]:
    """Entries to home one after another: those asked for, else the fleet's order and then the axes not in it."""
    if axes is not None:
        return axes
    ordered = {axis for entry in fleet.home_order for axis in fleet.expand(entry)}
    return [*fleet.home_order, *(axis for axis in fleet.axis_names if axis not in ordered)]


def check_job(fleet: Fleet, steps: list[Step]) -> None:
    """Refuse a job that names what the fleet does not have, before it is accepted. Raises `Refuse`."""
    for index, step in enumerate(steps):
        try:
            if isinstance(step, Move):
                for axis in step.to | step.by:
                    fleet.axis(axis)
            elif isinstance(step, Enable | Disable | Home):
                expand(fleet, step.axes or [])
            elif isinstance(step, SetOutput):
                _require_point(step.output, "output", {c: set(each.outputs) for c, each in fleet.controllers.items()})
            elif isinstance(step, WaitInput):
                _require_point(step.input, "input", {c: set(each.inputs) for c, each in fleet.controllers.items()})
        except ValueError as error:
            raise Refuse("unknown-name", f"steps[{index}] ({step.do}): {error}", "correct the job file") from None


def _require_point(name: str, kind: str, points: Mapping[str, set[str]]) -> None:
    controller, _, point = name.partition(".")
    if point not in points.get(controller, set()):
        known = sorted(f"{c}.{p}" for c, names in points.items() for p in names)
        raise ValueError(f"the fleet has no {kind} {name}; known: {', '.join(known) or 'none'}")
