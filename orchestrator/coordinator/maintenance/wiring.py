"""Whether the fleet is wired as its file says, without motion: each output is switched, and all inputs are read."""

from collections.abc import Mapping
from contextlib import suppress

from orchestrator.bus.base import BusError
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.coordinator.fleet.leases import LeaseBook
from orchestrator.coordinator.fleet.requests import Members
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.motion.targets import Refuse, refuse
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import OutputRequest, Reply
from orchestrator.model.service import WireFound
from orchestrator.model.state import ControllerState

ANSWER_S = 3.0
SEEN_NS = 600 * NS_PER_MS  # beyond a poll's period, for an input to be polled after its output was switched
LOOK_NS = 40 * NS_PER_MS
HOLDER = "wiring-check"


class WiringCheck:
    """Checks the wiring of the fleet of `view`."""

    def __init__(self, view: FleetView, members: Members, leases: LeaseBook, clock: Clock) -> None:
        self._view = view
        self._members = members
        self._leases = leases
        self._clock = clock

    async def check(self, actor: str) -> list[WireFound]:
        """What was found of each wire. Raises `Refuse` when axes are in use, or a controller can not be reached."""
        fleet = self._view.fleet
        concerned = sorted({each for wire in fleet.connections for each in (wire.source, wire.target)})
        if not concerned:
            raise Refuse("no-wiring", "the fleet file says nothing of `wiring`", "add it: from an output to inputs")
        # Whatever is armed to wait for a line would start by it.
        axes = [axis for name in concerned for axis in fleet.expand(name)]
        await self._leases.take(HOLDER, actor, "wiring check", axes)
        try:
            return [found for wire in fleet.wiring for found in await self._look(wire.from_, wire.to, actor)]
        finally:
            await self._leases.give_back(HOLDER)

    async def _look(self, output: str, inputs: list[str], actor: str) -> list[WireFound]:
        before, _ = await self._inputs()
        try:
            switched_ns = await self._switch(output, True, actor)
            during = await self._seen(switched_ns, before, inputs)
        finally:
            with suppress(Refuse):
                switched_ns = await self._switch(output, False, actor)
        after = await self._seen(switched_ns, during, [name for name in inputs if during[name]])
        found: list[WireFound] = []
        for name in inputs:
            ok, text, remedy = _judged(before[name], during[name], after[name])
            found.append(WireFound(output=output, input=name, ok=ok, text=text, remedy=remedy))
        crossed = [name for name, level in during.items() if name not in inputs and level != before[name]]
        for name in crossed:
            follows = after[name] == before[name]
            if follows:
                text = f"{name} follows {output}, although the fleet file does not say so"
                found.append(WireFound(output=output, input=name, ok=False, text=text, remedy="correct `wiring`"))
        return found

    async def _switch(self, output: str, value: bool, actor: str) -> int:
        """Gives the fleet time by which it was switched: it is read back."""
        controller, _, point = output.partition(".")
        request = OutputRequest(**self._members.fields(actor), output=point, value=value)
        reply = await self._members.ask(controller, "output", request, Reply, ANSWER_S)
        if reply.refused is not None:
            raise refuse(reply.refused)
        return (await self._state(controller)).read_fleet_ns or 0

    async def _seen(self, since_ns: int, before: Mapping[str, bool], wanted: list[str]) -> dict[str, bool]:
        """All inputs, as soon as everybody has been read after `since_ns` and those of `wanted` have changed, or after
        the longest time that this may take."""
        controllers = self._view.fleet.controllers
        period_s = max(1.0 / controllers[name].state.idle_hz for name in _with_inputs(self._view.fleet))
        until_ns = self._clock.now_ns() + round(period_s * NS_PER_S) + SEEN_NS
        while True:
            now, oldest_ns = await self._inputs()
            if oldest_ns > since_ns and all(now[name] != before[name] for name in wanted):
                return now
            if self._clock.now_ns() > until_ns:
                return now
            await sleep_ns(self._clock, LOOK_NS)

    async def _inputs(self) -> tuple[dict[str, bool], int]:
        """Every named input of the fleet, true: active; and when the oldest reading of them was, fleet time. Raises
        `Refuse` for one of a wire that can not be read."""
        levels: dict[str, bool] = {}
        read_ns: list[int] = []
        for name in _with_inputs(self._view.fleet):
            state = await self._state(name)
            levels |= {f"{name}.{point}": active for point, active in state.inputs.items()}
            read_ns.append(state.read_fleet_ns or 0)
        return levels, min(read_ns)

    async def _state(self, name: str) -> ControllerState:
        try:
            state = await self._view.fresh(name)
        except BusError as error:
            raise Refuse("absent", f"{name}: {error}", "is its adapter host running?", name) from None
        if state.mode == "offline":
            raise Refuse("offline", f"{name} can not be reached", "check its link", name)
        return state


def _with_inputs(fleet: Fleet) -> list[str]:
    return [name for name, controller in fleet.controllers.items() if controller.inputs]


def _judged(before: bool, during: bool, after: bool) -> tuple[bool, str, str]:
    """ok, text, remedy: of an input that should follow its output."""
    if not before and during and not after:
        return True, "follows", ""
    if before and not during and after:
        return (
            False,
            "follows the wrong way round: it is active while the output is not",
            "correct `active` of the input or of the output in the fleet file",
        )
    if before and during:
        return (
            False,
            "is active all the time: the line is stuck, or another output drives it",
            "look for a short, or for what drives it; then check `active` in the fleet file",
        )
    if not during:
        return (
            False,
            "does not follow: no wire, or a wrong one",
            "check the cable and the supply of the optocoupler; is the output's number right?",
        )
    return False, "does not follow when the output goes off", "check the line's pull-up"
