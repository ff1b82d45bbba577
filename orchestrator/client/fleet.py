"""Requests about the whole fleet and its controllers: status, stops, reset, information."""

import asyncio
from base64 import b64decode
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from pydantic import ValidationError

from orchestrator.bus.base import Priority
from orchestrator.bus.estop import put_estop
from orchestrator.client.connection import ANSWER_S, FleetConnection, absence_refusal
from orchestrator.client.results import FleetStates
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.service import (
    EpochRepaired,
    FleetLoaded,
    FleetNames,
    FleetReloaded,
    HandedOver,
    ReloadFleet,
    StopFleet,
    WireFinding,
    WiringChecked,
)
from orchestrator.model.messages import (
    EstopReset,
    Reply,
    Request,
    ResetRequest,
    StopRequest,
    TracePart,
    TraceReply,
    TraceRequest,
)
from orchestrator.model.names import split_name
from orchestrator.model.operation.learned import ForgetTimes
from orchestrator.model.operation.virtual_state import VirtualState, VirtualStates
from orchestrator.model.operation.zone_state import ZoneState
from orchestrator.model.problems import first_error_text
from orchestrator.model.state import ControllerInfo, ControllerState
from orchestrator.model.units import Unit

STOP_STATUS_S = 0.3  # for finding the controllers to stop: an adapter that takes longer to answer hangs
RELOAD_S = 60.0
WIRING_S = 60.0


class FleetRequests(FleetConnection):
    """Watch, stop and reset the fleet."""

    async def status(self, timeout_s: float = ANSWER_S) -> FleetStates:
        """The state of every controller that has an adapter now, by id. An adapter that hangs costs `timeout_s`; what
        cannot be read is left out."""
        states: list[ControllerState] = []
        for payload in (await self.bus.request_all(self.keys.state(), b"", timeout_s)).values():
            with suppress(ValidationError):
                states.append(ControllerState.read_message(payload))
        return FleetStates({state.controller: state for state in sorted(states, key=lambda state: state.controller)})

    async def virtual_states(self) -> dict[str, VirtualState]:
        """The state of every group of virtual axes, by its name; none of a fleet that has none. Raises `Refusal`."""
        reply = await self.request_service("virtual", Request(**self.request_fields()), VirtualStates)
        return {state.group: state for state in reply.groups}

    async def zone_state(self) -> ZoneState:
        """Where the bodies of the keep-out zones are now, mm, and what each rule says to that; all empty for a fleet
        without. Software, no safety function. Raises `Refusal`."""
        return await self.request_service("zones", Request(**self.request_fields()), ZoneState)

    async def stop(self, mode: str = "decelerate", known: Iterable[str] = ()) -> dict[str, Refusal | None]:
        """Stop every controller, directly, and the running jobs, and hold the queued ones.

        Returns the refusal of each controller, by id; None where it has accepted the stop. mode: `decelerate`, or
        `abort` for the shortest stop. known: controllers that are stopped at once, before any others are looked for.
        """
        fleet = StopFleet(**self.request_fields(), mode="abort" if mode == "abort" else "decelerate")
        request = StopRequest(**self.request_fields(), mode=fleet.mode)
        # The coordinator stops all controllers and jobs, but may be away; so each adapter is addressed directly, too.
        service = asyncio.ensure_future(self.request_service("stop", fleet, Reply))
        loop = asyncio.get_running_loop()
        stops = {name: loop.create_task(self.request_controller(name, "stop", request, Reply)) for name in known}
        for name in await self.status(STOP_STATUS_S):
            if name not in stops:
                stops[name] = loop.create_task(self.request_controller(name, "stop", request, Reply))
        *replies, _ = await asyncio.gather(*stops.values(), service, return_exceptions=True)
        return {
            controller: reply if isinstance(reply, Refusal) else None
            for controller, reply in zip(stops, replies, strict=True)
        }

    async def estop(self, reason: str = "", timeout_s: float = 2.0) -> dict[str, bool]:
        """Send an e-stop; return which controllers report its latch within `timeout_s`, by id."""
        put_estop(self.bus, self.keys.fleet, f"{self.actor}-{self.new_id()[:8]}", self.actor, reason)
        return await self.wait_for_latch(timeout_s)

    async def wait_for_latch(self, timeout_s: float = 2.0) -> dict[str, bool]:
        """Wait until all controllers report an e-stop latch, at most `timeout_s`; return which do, by id."""
        latches: dict[str, bool] = {}
        try:
            async with asyncio.timeout(timeout_s):
                while not latches or not all(latches.values()):
                    latches = {name: state.estop is not None for name, state in (await self.status()).items()}
        except TimeoutError:
            pass
        return latches

    async def reset(self, event: str | None = None) -> dict[str, Refusal | None]:
        """Release the e-stop latch named `event` (None: any) on every controller, and clear faults that can be cleared.

        All controllers check first whether it is safe; if one refuses, none is released. Returns the refusal of each,
        by id; None where it has been reset.
        """
        controllers = list(await self.status())
        answers: dict[str, Refusal | None] = {}
        for check in (True, False):
            requests = [
                self.request_controller(
                    controller, "reset", ResetRequest(**self.request_fields(), event=event, check=check), Reply
                )
                for controller in controllers
            ]
            replies = await asyncio.gather(*requests, return_exceptions=True)
            answers = {
                controller: reply if isinstance(reply, Refusal) else None
                for controller, reply in zip(controllers, replies, strict=True)
            }
            if any(answers.values()):
                return answers
        # Those that keep the latch for adapters that start.
        reset = EstopReset(event=event, actor=self.actor)
        self.bus.put(self.keys.estop_reset, reset.to_json(), Priority.EVENT)
        return answers

    async def reload_fleet(self, fleet: Fleet) -> list[str]:
        """Load another fleet file into the running fleet; return the controllers that have changed.

        Raises `Refusal`.
        """
        request = ReloadFleet(**self.request_fields(), configuration=fleet.to_plain())
        return (await self.request_service("reload", request, FleetReloaded, RELOAD_S)).changed

    async def load_fleet(self) -> Fleet:
        """The fleet file as it runs, without `notify`. Raises `Refusal`."""
        reply = await self.request_service("configuration", Request(**self.request_fields()), FleetLoaded)
        try:
            fleet = Fleet.model_validate(reply.configuration)
        except ValidationError as error:
            text = f"the configuration of the fleet cannot be read: {first_error_text(error)}"
            raise Refusal("bad-reply", text, "use the same version of Tutti everywhere") from None
        if fleet.digest != reply.digest:
            text = f"the configuration has digest {fleet.digest} here, {reply.digest or 'none'} in the coordinator"
            raise Refusal("other-configuration", text, "use the same version of Tutti everywhere")
        return fleet

    async def check_wiring(self) -> list[WireFinding]:
        """Check each wire of the fleet file; nothing moves. Raises `Refusal` while wired axes are in use."""
        request = Request(**self.request_fields())
        return (await self.request_service("check-wiring", request, WiringChecked, WIRING_S)).wires

    async def repair_epoch(self) -> list[str]:
        """Let controllers that remember another epoch accept the present coordinator; return them. Raises `Refusal`
        while an axis moves."""
        request = Request(**self.request_fields())
        return (await self.request_service("repair-epoch", request, EpochRepaired)).controllers

    async def hand_over(self) -> list[str]:
        """Let a standby lead; return the names of those that wait. Raises `Refusal` where none does, or something would
        be interrupted."""
        request = Request(**self.request_fields())
        return (await self.request_service("hand-over", request, HandedOver)).standbys

    async def forget_times(self, *controllers: str) -> None:
        """Forget what was learned of the times of controllers, in memory and in the journal: their next steps have the
        lead times that they declare. Without a name: of all, and of the fleet as a whole. Raises `Refusal`."""
        request = ForgetTimes(**self.request_fields(), controllers=list(controllers))
        await self.request_service("forget-times", request, Reply)

    async def list_names(self, timeout_s: float = ANSWER_S) -> FleetNames:
        """The names of the fleet: of its coordinator, or else of the adapters that answer. Raises `Refusal`, code
        `no-fleet`, if nothing answers."""
        try:
            return await self.request_service("names", Request(**self.request_fields()), FleetNames, timeout_s)
        except Refusal:
            states = await self.status(timeout_s)
        if not states:
            raise await self.find_absence()
        return FleetNames(
            controllers=list(states),
            axes={
                f"{name}.{axis}": Unit(axis_now.unit)
                for name, state in states.items()
                for axis, axis_now in state.axes.items()
            },
            inputs=[f"{name}.{point}" for name, state in states.items() for point in state.inputs],
            outputs=[f"{name}.{point}" for name, state in states.items() for point in state.outputs],
        )

    async def controller_info(self, controller: str) -> ControllerInfo:
        """Identity, capabilities and configuration of a controller, as its adapter has it. Raises `Refusal`."""
        request = Request(**self.request_fields())
        return await self._request(
            self.keys.info(controller), request, ControllerInfo, ANSWER_S, absence_refusal(controller)
        )

    async def axis_config(self, axis: str) -> dict[str, Any]:
        """The configuration of `controller.axis`, as its adapter has it. Raises `Refusal`."""
        controller, name = split_name(axis)
        info = await self.controller_info(controller)
        if name not in info.axes:
            text = f"{controller} has no axis {name!r}; its axes are: {', '.join(info.axes)}"
            raise Refusal("unknown-axis", text, "see `tutti axis ls`")
        return info.axes[name]

    async def read_trace(self, controller: str, *, after: int = 0, last_s: float | None = None) -> TraceReply:
        """The last minute of bytes on a controller's link, in the order of their instants.

        after: only what was recorded after the entry with this number, `newest` of an earlier answer. last_s: only that
        of so many seconds. Raises `Refusal`.
        """
        first = await self._read_trace_part(controller, after, None if last_s is None else round(last_s * NS_PER_S))
        if first.newest < after:  # the adapter was started again, and counts anew
            first = await self._read_trace_part(controller, 0, None)
        part, entries = first, list(first.entries)
        # What comes meanwhile is left to the next call: a busy link would never end.
        while entries and part.entries and entries[-1].number < first.newest:
            part = await self._read_trace_part(controller, entries[-1].number, None)
            entries += part.entries
        entries.sort(key=lambda entry: entry.at_ns)
        return TraceReply(
            entries=[(entry.at_ns, entry.direction, b64decode(entry.data).decode("latin-1")) for entry in entries],
            newest=max((entry.number for entry in entries), default=first.newest),
            lost=first.lost,
            make=part.make,
            options=part.options,
            utc=part.utc,
            host_ns=part.host_ns,
            fleet_ns=part.fleet_ns,
        )

    async def _read_trace_part(self, controller: str, after: int, last_ns: int | None) -> TracePart:
        request = TraceRequest(**self.request_fields(), after_entry=after, last_ns=last_ns)
        key = self.keys.trace(controller)
        return await self._request(key, request, TracePart, ANSWER_S, absence_refusal(controller))
