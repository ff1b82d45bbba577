"""Repair of epochs: controllers that remember a far epoch, and would refuse every coordinator for ever, accept this
leader's."""

import asyncio

from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import EpochRepaired
from orchestrator.model.messages import AcceptEpoch, Reply, Request
from orchestrator.model.state import ControllerState

ANSWER_S = 3.0


class EpochRepair:
    """Lets the controllers of `fleet` accept the epoch of this leadership."""

    def __init__(self, fleet: FleetAccess) -> None:
        self._fleet = fleet

    async def answer(self, request: Request) -> EpochRepaired:
        """Answer `svc/repair-epoch`. Raises `Refusal`."""
        controllers = await self.repair_epochs(request.actor)
        if controllers:
            self._fleet.log.warning(f"epoch repaired by {request.actor}: {', '.join(controllers)}")
        return EpochRepaired(controllers=controllers)

    async def repair_epochs(self, actor: str) -> list[str]:
        """Repair every controller that answers and is of another epoch; return their names. They are adopted by their
        next state.

        Raises `Refusal` if an axis of the fleet moves, or a controller does not accept the epoch.
        """
        requests, view = self._fleet.requests, self._fleet.view
        epoch = requests.leadership.epoch
        answers = await asyncio.gather(*map(view.query_state, view.fleet.controllers), return_exceptions=True)
        states = [answer for answer in answers if isinstance(answer, ControllerState)]
        moving_states = sorted(axis for state in states for axis in _find_moving(state))
        if moving_states:
            raise Refusal(
                "moving",
                f"{moving_states[0]} moves, or is about to",
                "wait until all axes are at rest (`tutti stop`), then repeat",
            )
        other_controllers = [state.controller for state in states if state.epoch != epoch]
        replies = await asyncio.gather(
            *(
                requests.request(name, "accept-epoch", AcceptEpoch(**requests.request_fields(actor)), Reply, ANSWER_S)
                for name in other_controllers
            )
        )
        for name, reply in zip(other_controllers, replies, strict=True):
            if reply.refused is not None:
                raise Refusal(reply.refused.code, f"{name}: {reply.refused.text}", reply.refused.remedy)
        return other_controllers


def _find_moving(state: ControllerState) -> list[str]:
    if state.mode == "offline":
        return []
    in_step = state.mode not in ("idle", "fault")  # also just before the first poll that shows a motion
    return [f"{state.controller}.{name}" for name, axis in state.axes.items() if in_step or axis.moving or axis.homing]
