"""Requests that are answered when an axis has found something: repeated while their answer may be lost, and given up as
soon as none can come."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.steps.context import ANSWER_S
from orchestrator.model.messages import LeasedRequest, RefusalDetails, Reply
from orchestrator.model.state import ControllerState

POLL_S = 0.05
REPEAT_S = 1.0
"""After this time the last state of an adapter that is not silent is one from after the request."""

R = TypeVar("R", bound=Reply)


@dataclass(frozen=True, slots=True)
class SearchRequest(Generic[R]):
    """A request to one controller. longest_s: until it is answered. searches: whether a state shows that it is carried
    out. activity: what is done, for the remedy: `then home again`."""

    controller: str
    verb: str
    request: LeasedRequest
    reply: type[R]
    longest_s: float
    searches: Callable[[ControllerState], bool]
    activity: str

    async def send(self, fleet: FleetAccess) -> R:
        """Send it, and return its reply; one with `refused` set if there is no valid reply."""
        view, loop, controller = fleet.view, asyncio.get_running_loop(), self.controller
        state = view.last_state(controller)
        instance = None if state is None else state.instance
        answer, begun_s = self._ask(fleet), loop.time()
        try:
            while True:
                await asyncio.wait([answer], timeout=POLL_S)
                if answer.done():
                    return answer.result()
                # The answer may take as long as its axes may search: stop waiting once it is known that none will come.
                absence = view.describe_absence(controller, instance)
                if absence is not None:
                    await fleet.stop_members([controller], "decelerate", self.request.actor, absence)
                    remedy = f"check its adapter host (`tutti status`), then {self.activity} again"
                    return self.reply(
                        refused=RefusalDetails(code="absent", text=absence, remedy=remedy, member=controller)
                    )
                if loop.time() - begun_s > REPEAT_S and not self._is_carried_out(fleet):
                    # The request or its answer was lost. It keeps its id, so it is executed once.
                    answer.cancel()
                    answer, begun_s = self._ask(fleet), loop.time()
        finally:
            answer.cancel()

    def _ask(self, fleet: FleetAccess) -> asyncio.Task[R]:
        timeout_s = self.longest_s + ANSWER_S
        return asyncio.get_running_loop().create_task(
            fleet.requests.request(self.controller, self.verb, self.request, self.reply, timeout_s)
        )

    def _is_carried_out(self, fleet: FleetAccess) -> bool:
        state = fleet.view.last_state(self.controller)
        return state is not None and self.searches(state)
