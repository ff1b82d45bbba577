"""Wiring check: switch each wired output and read all inputs, without motion."""

from collections.abc import Mapping
from contextlib import suppress

from orchestrator.bus.base import BusError
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.lease_states import LeaseUser
from orchestrator.coordinator.fleet.leases import LeaseRegistry
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.service import WireFinding
from orchestrator.model.messages import OutputRequest, Reply
from orchestrator.model.names import split_name
from orchestrator.model.state import ControllerState

ANSWER_S = 3.0
POLL_MARGIN_NS = 600 * NS_PER_MS  # beyond a poll's period, for an input to be polled after its output was switched
POLL_NS = 40 * NS_PER_MS
HOLDER = "wiring-check"


class WiringCheck:
    """Checks the wiring of the fleet of `view`."""

    def __init__(self, fleet: FleetAccess, leases: LeaseRegistry) -> None:
        self._fleet = fleet
        self._leases = leases

    async def check_wires(self, actor: str) -> list[WireFinding]:
        """Check each wire. Raises `Refusal` when axes are in use, or a controller is offline."""
        fleet = self._fleet.view.fleet
        controllers = sorted({point for wire in fleet.connections for point in (wire.source, wire.target)})
        if not controllers:
            raise Refusal(
                "no-wiring", "the fleet file has no `wiring`", "add it: each entry leads from an output to inputs"
            )
        # An armed member that waits for a trigger line would start by the check.
        axes = [axis for name in controllers for axis in fleet.expand_name(name)]
        await self._leases.acquire(LeaseUser(HOLDER, actor, "wiring check"), axes)
        try:
            return [
                finding for wire in fleet.wiring for finding in await self._check_output(wire.from_, wire.to, actor)
            ]
        finally:
            await self._leases.release(HOLDER)

    async def _check_output(self, output: str, inputs: list[str], actor: str) -> list[WireFinding]:
        inputs_before, _ = await self._read_inputs()
        try:
            switched_ns = await self._switch_output(output, value=True, actor=actor)
            during = await self._wait_for_inputs(switched_ns, inputs_before, inputs)
        finally:
            with suppress(Refusal):
                switched_ns = await self._switch_output(output, value=False, actor=actor)
        inputs_after = await self._wait_for_inputs(switched_ns, during, [name for name in inputs if during[name]])
        findings: list[WireFinding] = []
        for name in inputs:
            ok, text, remedy = _judge_input(before=inputs_before[name], during=during[name], after=inputs_after[name])
            findings.append(WireFinding(output=output, input=name, ok=ok, text=text, remedy=remedy))
        crossed_inputs = [name for name, level in during.items() if name not in inputs and level != inputs_before[name]]
        for name in crossed_inputs:
            follows = inputs_after[name] == inputs_before[name]
            if follows:
                text = f"{name} follows {output}, but the fleet file has no such wire"
                findings.append(WireFinding(output=output, input=name, ok=False, text=text, remedy="correct `wiring`"))
        return findings

    async def _switch_output(self, output: str, actor: str, *, value: bool) -> int:
        """Switch an output; return the fleet time by which it was switched: it is read back."""
        controller, point = split_name(output)
        request = OutputRequest(**self._fleet.requests.request_fields(actor), output=point, value=value)
        reply = await self._fleet.requests.request(controller, "output", request, Reply, ANSWER_S)
        if reply.refused is not None:
            raise reply.refused.as_step_error()
        return (await self._query_state(controller)).read_fleet_ns or 0

    async def _wait_for_inputs(self, since_ns: int, before: Mapping[str, bool], wanted: list[str]) -> dict[str, bool]:
        """Wait until all controllers have been polled after `since_ns` and the inputs of `wanted` have changed, or
        until the maximum time for that; return all inputs."""
        controllers = self._fleet.view.fleet.controllers
        period_s = max(
            1.0 / controllers[name].state.idle_hz for name in _controllers_with_inputs(self._fleet.view.fleet)
        )
        until_ns = self._fleet.clock.now_ns() + round(period_s * NS_PER_S) + POLL_MARGIN_NS
        while True:
            levels, oldest_ns = await self._read_inputs()
            if oldest_ns > since_ns and all(levels[name] != before[name] for name in wanted):
                return levels
            if self._fleet.clock.now_ns() > until_ns:
                return levels
            await sleep_ns(self._fleet.clock, POLL_NS)

    async def _read_inputs(self) -> tuple[dict[str, bool], int]:
        """All named inputs of the fleet, true: active; and the fleet time of the oldest reading of them. Raises
        `Refusal` if an input of a wire cannot be read."""
        levels: dict[str, bool] = {}
        read_ns: list[int] = []
        for name in _controllers_with_inputs(self._fleet.view.fleet):
            state = await self._query_state(name)
            levels |= {f"{name}.{point}": active for point, active in state.inputs.items()}
            read_ns.append(state.read_fleet_ns or 0)
        return levels, min(read_ns)

    async def _query_state(self, name: str) -> ControllerState:
        try:
            state = await self._fleet.view.query_state(name)
        except BusError as error:
            raise self._fleet.view.make_absence(name, str(error)) from None
        if state.mode == "offline":
            raise Refusal("offline", f"{name} is offline", "check its link", name)
        return state


def _controllers_with_inputs(fleet: Fleet) -> list[str]:
    return [name for name, controller in fleet.controllers.items() if controller.inputs]


def _judge_input(*, before: bool, during: bool, after: bool) -> tuple[bool, str, str]:
    """(ok, text, remedy) for an input that should follow its output."""
    if not before and during and not after:
        return True, "follows", ""
    if before and not during and after:
        return (
            False,
            "is inverted: it is active while the output is not",
            "correct `active` of the input or of the output in the fleet file",
        )
    if before and during:
        return (
            False,
            "is always active: the line is stuck, or driven by another output",
            "look for a short circuit or another driver of the line; then check `active` in the fleet file",
        )
    if not during:
        return (
            False,
            "does not follow: the wire is missing, or leads elsewhere",
            "check the cable, the supply of the optocoupler, and the number of the output",
        )
    return False, "does not follow when the output is switched off", "check the line's pull-up"
