"""Steps without synchronised motion: enable, home, set-position, dwell, output, wait."""

from collections.abc import Mapping

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.requests import FencedFields
from orchestrator.coordinator.jobs.homing import HomingSequence, ProgressCallback
from orchestrator.model.duration import format_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.job import Disable, Dwell, Enable, Home, Latch, SetOutput, SetPosition, Step, WaitInput
from orchestrator.model.messages import (
    EnableRequest,
    LatchReply,
    LatchRequest,
    LeasedRequest,
    OutputRequest,
    Reply,
    SetPositionRequest,
    raise_first_refusal,
)
from orchestrator.model.report import LatchReport
from orchestrator.model.state import TimeInterval
from orchestrator.plan.step import ExactTargets

ANSWER_S = 3.0
INPUT_POLL_NS = 20 * NS_PER_MS


class PlainSteps:
    """Runs steps on controllers one by one; each raises `Refusal` with the reason if it cannot be done."""

    def __init__(self, fleet: FleetAccess, targets: ExactTargets) -> None:
        self._fleet = fleet
        self._targets = targets
        self._homing = HomingSequence(fleet, targets)

    async def run_step(self, step: Step, holder: str, actor: str, progress: ProgressCallback) -> LatchReport | None:
        """Run `step` to its end; return what it has latched, if it is for that. holder: has the leases of its axes."""
        if isinstance(step, Latch):
            return await self._latch_position(step, holder, actor)
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
        return None

    async def _latch_position(self, step: Latch, holder: str, actor: str) -> LatchReport:
        """Have the controller capture a position. Raises `Refusal`."""
        controller, _, axis = step.axis.partition(".")
        request = LatchRequest(
            **self._request_fields(actor),
            axes=[axis],
            holder=holder,
            input=step.input.partition(".")[2],
            within_ns=step.timeout,
        )
        timeout_s = ANSWER_S + step.timeout / NS_PER_S
        replies = await self._fleet.requests.request_all("latch", {controller: request}, LatchReply, timeout_s)
        raise_first_refusal(replies)
        reply, config = replies[controller], self._fleet.view.fleet.axis(step.axis)
        state = self._fleet.view.axis_now(step.axis)
        offset = 0.0 if state is None else float(state.offset)
        return LatchReport(
            axis=step.axis,
            input=step.input,
            position=config.to_unit(reply.counts) + offset,
            unit=config.unit,
            counts=reply.counts,
            seen=TimeInterval(earliest_ns=reply.earliest_ns, latest_ns=reply.latest_ns),
        )

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
        try:
            await self._request_all("output", {controller: request}, ANSWER_S)
            if step.pulse is not None:
                await sleep_ns(self._fleet.clock, step.pulse)
        finally:
            # Also when the job ends meanwhile: a pulse that does not end may be a shutter that stays open.
            if step.pulse is not None:
                back = OutputRequest(**self._request_fields(actor), output=output, value=not step.value)
                await self._request_all("output", {controller: back}, ANSWER_S)

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
