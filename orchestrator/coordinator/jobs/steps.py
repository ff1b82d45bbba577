"""Steps without synchronised motion: enable, home, set-position, dwell, output, wait."""

from collections.abc import Mapping

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.requests import FencedFields
from orchestrator.coordinator.jobs.homing import HomingSequence, ProgressCallback, find_prerequisites, homing_order
from orchestrator.model.duration import format_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet, group_by_controller
from orchestrator.model.job import Disable, Dwell, Enable, Home, Move, SetOutput, SetPosition, Step, WaitInput
from orchestrator.model.messages import (
    EnableRequest,
    LeasedRequest,
    OutputRequest,
    Reply,
    SetPositionRequest,
    raise_first_refusal,
)
from orchestrator.model.units import parse_quantity
from orchestrator.plan.step import ExactTargets

ANSWER_S = 3.0
INPUT_POLL_NS = 20 * NS_PER_MS


class PlainSteps:
    """Runs steps on controllers one by one; each raises `Refusal` with the reason if it cannot be done."""

    def __init__(self, fleet: FleetAccess, targets: ExactTargets) -> None:
        self._fleet = fleet
        self._targets = targets
        self._homing = HomingSequence(fleet, targets)

    async def run_step(self, step: Step, holder: str, actor: str, progress: ProgressCallback) -> None:
        """Run `step` to its end. holder: has the leases of its axes."""
        if isinstance(step, Enable | Disable):
            await self.switch_motors(
                self._fleet.view.fleet.expand_names(step.axes), on=isinstance(step, Enable), holder=holder, actor=actor
            )
        elif isinstance(step, Home):
            await self._homing.run(step.axes, holder, actor, progress)
        elif isinstance(step, SetPosition):
            await self._set_position(step, holder, actor)
        elif isinstance(step, Dwell):
            await sleep_ns(self._fleet.clock, step.duration)
        elif isinstance(step, SetOutput):
            await self._set_output(step, actor)
        elif isinstance(step, WaitInput):
            await self._wait_input(step)

    async def switch_motors(self, axes: list[str], holder: str, actor: str, *, on: bool) -> None:
        """Switch the motors of `axes`, with their brakes. Raises `Refusal`."""
        requests = {
            member: EnableRequest(**self._request_fields(actor), axes=names, on=on, holder=holder)
            for member, names in group_by_controller(axes).items()
        }
        brakes = [brake for axis in axes if (brake := self._fleet.view.fleet.axis(axis).brake) is not None]
        longest_s = max((brake.release_s if on else brake.engage_s for brake in brakes), default=0.0)
        await self._request_all("enable", requests, ANSWER_S + longest_s)

    async def _set_position(self, step: SetPosition, holder: str, actor: str) -> None:
        for axis, position in step.axes.items():
            controller, _, name = axis.partition(".")
            self._targets.forget_target(axis)
            request = SetPositionRequest(**self._request_fields(actor), axes=[name], holder=holder, position=position)
            await self._request_all("set-position", {controller: request}, ANSWER_S)

    async def _set_output(self, step: SetOutput, actor: str) -> None:
        controller, _, output = step.output.partition(".")
        request = OutputRequest(**self._request_fields(actor), output=output, value=step.value)
        await self._request_all("output", {controller: request}, ANSWER_S)

    async def _wait_input(self, step: WaitInput) -> None:
        controller, _, name = step.input.partition(".")
        until_ns = self._fleet.clock.now_ns() + step.timeout
        view = self._fleet.view
        while True:
            state = view.last_state(controller)
            if state is not None and not view.is_silent(controller) and state.inputs.get(name) == step.value:
                return
            if self._fleet.clock.now_ns() >= until_ns:
                wanted = "active" if step.value else "inactive"
                raise Refusal(
                    "wait-timeout",
                    f"input {step.input} did not become {wanted} within {format_ns(step.timeout)}",
                    "",
                    controller,
                )
            await sleep_ns(self._fleet.clock, INPUT_POLL_NS)

    async def _request_all(
        self, verb: str, requests: Mapping[str, LeasedRequest | OutputRequest], timeout_s: float
    ) -> None:
        raise_first_refusal(await self._fleet.requests.request_all(verb, requests, Reply, timeout_s))

    def _request_fields(self, actor: str) -> FencedFields:
        return self._fleet.requests.request_fields(actor)


def check_job(fleet: Fleet, steps: list[Step]) -> None:
    """Check that the fleet has all names of a job, before it is accepted. Raises `Refusal`."""
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
                fleet.expand_names(step.axes or [])
                if isinstance(step, Home):
                    find_prerequisites(fleet, homing_order(fleet, step.axes))
            elif isinstance(step, SetOutput):
                _require_point(step.output, "output", {c: set(each.outputs) for c, each in fleet.controllers.items()})
            elif isinstance(step, WaitInput):
                _require_point(step.input, "input", {c: set(each.inputs) for c, each in fleet.controllers.items()})
        except ValueError as error:
            raise Refusal("unknown-name", f"steps[{index}] ({step.do}): {error}", "correct the job file") from None


def _require_point(name: str, kind: str, points: Mapping[str, set[str]]) -> None:
    controller, _, point = name.partition(".")
    if point not in points.get(controller, set()):
        known = sorted(f"{c}.{p}" for c, names in points.items() for p in names)
        raise ValueError(f"the fleet has no {kind} {name}; known: {', '.join(known) or 'none'}")
