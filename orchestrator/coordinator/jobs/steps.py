"""The steps that are no synchronised motion: enable, home, dwell, output, wait."""

from collections.abc import Mapping

from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.coordinator.fleet.requests import FencedFields, Members
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.jobs.homing import Homing, Progress, homing_order, must_wait_for
from orchestrator.coordinator.motion.targets import Refuse, refuse_if_any
from orchestrator.model.duration import format_ns
from orchestrator.model.fleet import Fleet, by_controller
from orchestrator.model.job import Disable, Dwell, Enable, Home, Move, SetOutput, SetPosition, Step, WaitInput
from orchestrator.model.messages import EnableRequest, LeasedRequest, OutputRequest, Reply, SetPositionRequest
from orchestrator.model.units import parse_quantity
from orchestrator.plan.step import Targets

ANSWER_S = 3.0
LOOK_NS = 20 * NS_PER_MS


class PlainSteps:
    """Runs steps on controllers one by one; each raises `Refuse` with the reason if it can not be done."""

    def __init__(self, view: FleetView, members: Members, clock: Clock, targets: Targets, homing: Homing) -> None:
        self._view = view
        self._members = members
        self._clock = clock
        self._targets = targets
        self._homing = homing

    async def run(self, step: Step, holder: str, actor: str, progress: Progress) -> None:
        """Run `step` to its end, with axes that `holder` has the leases of."""
        if isinstance(step, Enable | Disable):
            await self.enable(expand(self._view.fleet, step.axes), isinstance(step, Enable), holder, actor)
        elif isinstance(step, Home):
            await self._homing.run(step.axes, holder, actor, progress)
        elif isinstance(step, SetPosition):
            await self._set_position(step, holder, actor)
        elif isinstance(step, Dwell):
            await sleep_ns(self._clock, step.duration)
        elif isinstance(step, SetOutput):
            await self._output(step, actor)
        elif isinstance(step, WaitInput):
            await self._wait(step)

    async def enable(self, axes: list[str], on: bool, holder: str, actor: str) -> None:
        """Switch the motors of `axes`, with their brakes. Raises `Refuse`."""
        requests = {
            member: EnableRequest(**self._fields(actor), axes=names, on=on, holder=holder)
            for member, names in by_controller(axes).items()
        }
        brakes = [brake for axis in axes if (brake := self._view.fleet.axis(axis).brake) is not None]
        longest_s = max((brake.release_s if on else brake.engage_s for brake in brakes), default=0.0)
        await self._all("enable", requests, ANSWER_S + longest_s)

    async def _set_position(self, step: SetPosition, holder: str, actor: str) -> None:
        for axis, position in step.axes.items():
            controller, _, name = axis.partition(".")
            self._targets.forget(axis)
            request = SetPositionRequest(**self._fields(actor), axes=[name], holder=holder, position=position)
            await self._all("set-position", {controller: request}, ANSWER_S)

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

    async def _all(self, verb: str, requests: Mapping[str, LeasedRequest | OutputRequest], timeout_s: float) -> None:
        refuse_if_any(await self._members.ask_all(verb, requests, Reply, timeout_s))

    def _fields(self, actor: str) -> FencedFields:
        return self._members.fields(actor)


def expand(fleet: Fleet, names: list[str]) -> list[str]:
    """The axes that a list of axes, groups and controllers stands for, each once, in order."""
    return list(dict.fromkeys(axis for name in names for axis in fleet.expand(name)))


def check_job(fleet: Fleet, steps: list[Step]) -> None:
    """Refuse a job that names what the fleet does not have, before it is accepted. Raises `Refuse`."""
    for index, step in enumerate(steps):
        try:
            if isinstance(step, Move):
                for axis in step.to | step.by:
                    fleet.axis(axis)
            elif isinstance(step, SetPosition):
                for name, position in step.axes.items():
                    axis = fleet.axis(name)
                    if position is not None:
                        parse_quantity(position, axis.unit)
            elif isinstance(step, Enable | Disable | Home):
                expand(fleet, step.axes or [])
                if isinstance(step, Home):
                    must_wait_for(fleet, homing_order(fleet, step.axes))
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
