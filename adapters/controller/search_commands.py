"""The commands that move axes until they find something: their references, or a contact."""

from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import TypeVar

from adapters.controller.components import Components
from adapters.controller.stops import ControllerStops
from orchestrator.clock.base import Clock
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault
from orchestrator.model.messages import HomeReply, HomeRequest, LeasedRequest, ProbeReply, ProbeRequest, Reply

R = TypeVar("R", bound=Reply)


class SearchCommands:
    """Homing and probes of one controller. require_idle: raises `Refusal` unless the requester may use its axes, and no
    step is loaded."""

    def __init__(
        self,
        components: Components,
        stops: ControllerStops,
        clock: Clock,
        require_idle: Callable[[LeasedRequest], None],
    ) -> None:
        self._components = components
        self._stops = stops
        self._clock = clock
        self._require_idle = require_idle

    async def home(self, request: HomeRequest) -> HomeReply:
        """Find the references of axes. Raises `Refusal`."""
        self._require_allowed(request)
        return await self._search("homing", self._components.referencing.home_axes(request.axes))

    async def probe(self, request: ProbeRequest) -> ProbeReply:
        """Move an axis until an input changes. Raises `Refusal`."""
        self._require_allowed(request)
        return await self._search("the probe", self._components.probing.probe(request))

    def _require_allowed(self, request: LeasedRequest) -> None:
        self._require_idle(request)
        self._components.fence.require_no_estop()

    async def _search(self, name: str, search: Awaitable[R]) -> R:
        self._components.timer.wake_up()  # from now on it is polled at the rate of motion
        try:
            return await search
        except (LinkClosed, LinkRefused, ControllerFault) as error:
            # The controller continues its motion by itself. If the stop cannot be sent now, it stays pending.
            with suppress(LinkClosed, LinkRefused, ControllerFault):
                await self._stops.stop(abort=False, reason=f"{name} has failed: {error}")
            raise
        finally:
            self._components.status.ordered_ns = self._clock.now_ns()
