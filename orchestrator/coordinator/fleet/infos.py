"""Identities and capabilities of the controllers, asked for once in each start of their adapters, those of a host
together."""

import asyncio
from collections.abc import Callable, Iterable, Mapping

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusError
from orchestrator.bus.keys import FleetKeys
from orchestrator.coordinator.fleet.batches import HostBatches
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.state import ControllerInfo, ControllerState

QUERY_S = 1.0  # for an adapter to answer a query


class ControllerInfos:
    """The information of all controllers.

    servers: by controller, the process whose replies count. states: by controller, its last state. configs: returns the
    controllers of the fleet file.
    """

    def __init__(
        self,
        bus: Bus,
        keys: FleetKeys,
        servers: Mapping[str, str],
        states: Mapping[str, ControllerState],
        configs: Callable[[], Mapping[str, Controller]],
    ) -> None:
        self._bus, self._keys = bus, keys
        self._batches = HostBatches(bus, keys)
        self._servers, self._states, self._configs = servers, states, configs
        self._infos: dict[str, ControllerInfo] = {}
        self.make_absence: Callable[[str, str], Refusal] = lambda controller, reason: Refusal(
            "absent", f"{controller}: {reason}", "", controller
        )
        """Makes the refusal for a controller whose adapter does not answer, from the reason that the bus knows."""

    def find(self, controller: str) -> ControllerInfo | None:
        """Identity and capabilities of the adapter that runs now, if they are known."""
        info, state = self._infos.get(controller), self._states.get(controller)
        return info if info is not None and state is not None and info.instance == state.instance else None

    async def query(self, controller: str) -> ControllerInfo:
        """Identity and capabilities of the controller; asked for once per instance of its adapter. Raises `BusError`,
        `ValidationError`."""
        info = self.find(controller)
        if info is None:
            info = self._infos[controller] = await self.ask(controller)
        return info

    async def require(self, controller: str) -> ControllerInfo:
        """The same. Raises `Refusal`."""
        try:
            return await self.query(controller)
        except BusError as error:
            raise self.make_absence(controller, str(error)) from None

    async def ask(self, controller: str) -> ControllerInfo:
        """Identity and capabilities of the controller as of now: it may not be connected yet. Raises `BusError`,
        `ValidationError`."""
        server = self._servers.get(controller)
        return ControllerInfo.read_message(await self._bus.request(self._keys.info(controller), b"", QUERY_S, server))

    async def ask_host(self, host: str, controllers: Iterable[str]) -> dict[str, ControllerInfo]:
        """The same of several controllers of one host and one process, by one request. Those that do not answer are
        left out; so are all of a host of protocol 1.5, which does not take this request."""
        names = list(controllers)
        try:
            reply = await self._batches.ask(
                (host, self._servers.get(names[0])), "info", dict.fromkeys(names, ""), QUERY_S
            )
        except (BusError, ValidationError):
            return {}
        infos: dict[str, ControllerInfo] = {}
        for name in names:
            try:
                infos[name] = ControllerInfo.read_message(reply.replies[name])
            except (KeyError, ValidationError):
                continue
        return infos

    async def prefetch(self, controllers: Iterable[str]) -> None:
        """Ask for what is not known yet, all at once. A controller that does not answer is left to the query that needs
        it."""
        groups: dict[tuple[str, str | None], list[str]] = {}
        for name in controllers:
            if self.find(name) is None and name in self._configs():
                groups.setdefault((self._configs()[name].host, self._servers.get(name)), []).append(name)

        async def ask_group(host: str, names: list[str]) -> None:
            if len(names) > 1:
                self._infos |= await self.ask_host(host, names)
            missing_names = [name for name in names if self.find(name) is None]
            await asyncio.gather(*map(self.query, missing_names), return_exceptions=True)

        if sum(map(len, groups.values())) > 1:
            await asyncio.gather(*(ask_group(host, names) for (host, _), names in groups.items()))
