"""Adoption of every controller that is published and not adopted by this leader yet, those of a host together."""

import asyncio
from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import dataclass

from orchestrator.bus.base import BusError
from orchestrator.bus.keys import FleetKeys
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.leadership.leadership import Leadership
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import COMPARING, AdoptedReply, AdoptRequest
from orchestrator.model.state import ControllerInfo
from orchestrator.model.version import OTHER_VERSION, PartVersion, require_version

ADOPT_S = 2.0


@dataclass(frozen=True, slots=True)
class AdoptionReports:
    """What is done with the outcome. version: a controller is not adopted because of its version. double_answer: two
    processes answer on a key. worked: called before a controller counts as adopted, with the job that has commanded
    something there last. adopted: a controller is adopted."""

    version: Callable[[str, Refusal], None]
    double_answer: Callable[[str], None]
    worked: Callable[[str, AdoptedReply], Awaitable[None]]
    adopted: Callable[[str], Awaitable[None]]


class FleetAdoption:
    """Adopts for one leadership: from then on only the replies of the process that has answered count."""

    def __init__(self, fleet: FleetAccess, keys: FleetKeys, leadership: Leadership, reports: AdoptionReports) -> None:
        self._fleet, self._view = fleet, fleet.view
        self._keys = keys
        self._leadership = leadership
        self._reports = reports
        self._adopting: dict[str, str] = {}
        """By controller that is being adopted, or is about to be: the instance of its adapter."""
        self._next: list[str] = []

    def take_arrivals(self, controllers: Collection[str]) -> None:
        """Adopt those of `controllers` that need it: their states have arrived, or hold still."""
        if self._leadership.over or not self._leadership.epoch:
            return
        for controller in controllers:
            state = self._view.arrived_states.get(controller)
            if state is None or controller in self._adopting or not self.is_due(controller):
                continue
            if (refusal := self._view.find_refusal(controller)) is not None:
                self._reports.version(controller, refusal)
                continue
            if not self._next:
                # What else arrives in this turn of the loop is adopted together with it.
                asyncio.get_running_loop().call_soon(self._begin)
            self._adopting[controller] = state.instance
            self._next.append(controller)

    def is_due(self, controller: str) -> bool:
        """Whether the adapter of a controller, as it runs now, is to be adopted by this leader."""
        state = self._view.arrived_states[controller]
        return self._view.adopted.get(controller) != state.instance or state.epoch != self._leadership.epoch

    def _begin(self) -> None:
        controllers, self._next = self._next, []
        self._fleet.tasks.spawn(self._adopt(controllers), vital=False)

    async def _adopt(self, controllers: list[str]) -> None:
        try:
            groups: dict[str, list[str]] = {}
            for controller in await self._bind_servers(controllers):
                groups.setdefault(self._view.fleet.controllers[controller].host, []).append(controller)
            await asyncio.gather(*(self._adopt_group(host, names) for host, names in groups.items()))
        finally:
            for controller in controllers:
                self._adopting.pop(controller, None)

    async def _bind_servers(self, controllers: list[str]) -> list[str]:
        """Find the processes that answer for controllers, and return those for which exactly one does."""
        servers_found: Mapping[str, set[str]] = {}
        reason = ""
        try:
            servers_found = await self._view.find_servers(controllers)
        except BusError as error:
            reason = str(error)
        bound: list[str] = []
        for controller in controllers:
            servers = servers_found.get(controller, set())
            if len(servers) == 1:
                self._view.servers[controller] = next(iter(servers))
                bound.append(controller)
            elif servers:
                self._reports.double_answer(self._keys.state(controller))
            else:
                text = reason or f"no process serves {self._keys.state(controller)}"
                self._fleet.log.warning(f"not adopted: {text}", controller=controller)
        return bound

    async def _adopt_group(self, host: str, controllers: list[str]) -> None:
        """Adopt controllers of one host whose versions fit."""
        known_infos = await self._view.infos.ask_host(host, controllers) if len(controllers) > 1 else {}
        accepted_names: list[str] = []
        for controller in controllers:
            try:
                await self._check_part(controller, known_infos.get(controller))
                accepted_names.append(controller)
            except Refusal as refusal:
                self._note_version(controller, refusal)
            except BusError as error:
                self._fleet.log.warning(f"not adopted: {error}", controller=controller)
        heartbeat = self._leadership.make_heartbeat()
        requests = {
            controller: AdoptRequest(**self._fleet.requests.request_fields("coordinator"), leader=heartbeat)
            for controller in accepted_names
        }
        replies = await self._fleet.requests.request_all("adopt", requests, AdoptedReply, ADOPT_S) if requests else {}
        for controller, reply in replies.items():
            if reply.refused is None and reply.last_job:
                await self._reports.worked(controller, reply)
            self._take_reply(controller, reply)
        adopted_names = [controller for controller, reply in replies.items() if reply.refused is None]
        await asyncio.gather(*map(self._reports.adopted, adopted_names))

    async def _check_part(self, controller: str, info: ControllerInfo | None) -> None:
        """Take note of the adapter's certificate. Raises `Refusal` for a version too far from this one, `BusError`."""
        try:
            info = info or await self._view.infos.ask(controller)
            stated_version = PartVersion(info.tutti, info.protocol)
            self._fleet.certificates.note_stated(controller, info.certificate)
        except ValueError:
            stated_version = PartVersion("", "")
        host = self._view.fleet.controllers[controller].host
        require_version(stated_version, f"the adapter of {controller} (adapter host {host})", "the coordinator")

    def _take_reply(self, controller: str, reply: AdoptedReply) -> None:
        if reply.refused is None:
            self._view.adopted[controller] = self._adopting[controller]
            self._fleet.log.info("adopted", controller=controller, epoch=self._leadership.epoch)
        elif reply.refused.code == OTHER_VERSION:
            self._note_version(controller, reply.refused.as_step_error())
        elif reply.refused.code != COMPARING:  # then its next state brings it here again
            self._fleet.log.warning(f"not adopted: {reply.refused.text}", controller=controller)

    def _note_version(self, controller: str, refusal: Refusal) -> None:
        self._view.refused[controller] = (self._adopting[controller], refusal)
        self._reports.version(controller, refusal)
        self._fleet.log.warning(f"not adopted: {refusal.text}; {refusal.remedy}", controller=controller)
