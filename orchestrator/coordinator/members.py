"""Requests to members. Whatever goes wrong on the way becomes a refusal: a value that names the member."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypedDict, TypeVar

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusError, NoReply, RequestTimeout
from orchestrator.bus.keys import Keys
from orchestrator.coordinator.reign import Throne
from orchestrator.model.messages import Refusal, Reply, Request

R = TypeVar("R", bound=Reply)

ANSWER_S = 2.0
"""An adapter that has not answered a small request by then is hung."""
TRY_S = 0.3
"""For one try of what is insisted on: the usual answer to a stop takes a tenth of that."""
AGAIN_S = 0.05
ABSENT_S = 0.7
"""An adapter that lives, but has not heard of the coordinator for half a second, has stopped by itself by then."""


class FencedFields(TypedDict):
    """What every fenced request carries."""

    request_id: str
    actor: str
    epoch: int
    coordinator: str


@dataclass(frozen=True, slots=True)
class Members:
    """Asks controllers on the bus, in the name of this reign."""

    bus: Bus
    keys: Keys
    throne: Throne
    new_id: Callable[[], str]

    def fields(self, actor: str) -> FencedFields:
        """What every fenced request carries."""
        return {
            "request_id": self.new_id(),
            "actor": actor,
            "epoch": self.throne.epoch,
            "coordinator": self.throne.coordinator,
        }

    async def ask(self, member: str, verb: str, request: Request, reply: type[R], timeout_s: float) -> R:
        """Send `request` to `member` and give its reply; one with `refused` set if there is none of use."""
        try:
            return await self._answer(member, verb, request, reply, timeout_s)
        except (BusError, ValidationError) as error:
            return reply(refused=_refusal(member, verb, error, timeout_s))

    async def insist(self, member: str, verb: str, request: Request, reply: type[R], timeout_s: float) -> R:
        """`ask`, again and again for `timeout_s`: where something moves, a bus that was away for a moment (its router
        is started again) is no reason not to be heard. It is done once, because it keeps its id.

        Where no adapter is to be found, that ends after `ABSENT_S`.
        """
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        while True:
            try:
                return await self._answer(member, verb, request, reply, TRY_S)
            except (BusError, ValidationError) as error:
                unheard = isinstance(error, NoReply | RequestTimeout)
                longest_s = ABSENT_S if isinstance(error, NoReply) else timeout_s
                if not unheard or loop.time() - begun_s >= longest_s:
                    return reply(refused=_refusal(member, verb, error, timeout_s))
            await asyncio.sleep(AGAIN_S)

    async def ask_all(
        self,
        verb: str,
        requests: Mapping[str, Request],
        reply: type[R],
        timeout_s: float = ANSWER_S,
        insist: bool = False,
        answered: Callable[[str], None] | None = None,
    ) -> dict[str, R]:
        """`ask` several members, or `insist`, all at once; the replies by member. answered: told of each at once."""

        async def ask(member: str, request: Request) -> R:
            said = await (self.insist if insist else self.ask)(member, verb, request, reply, timeout_s)
            if answered is not None:
                answered(member)
            return said

        asked = [ask(member, request) for member, request in requests.items()]
        return dict(zip(requests, await asyncio.gather(*asked), strict=True))

    async def _answer(self, member: str, verb: str, request: Request, reply: type[R], timeout_s: float) -> R:
        payload = await self.bus.request(self.keys.cmd(member, verb), request.to_json(), timeout_s)
        return reply.model_validate_json(payload)


def _refusal(member: str, verb: str, error: BusError | ValidationError, timeout_s: float) -> Refusal:
    code, remedy = "bad-request", ""
    match error:
        case NoReply():
            code, text = "absent", f"no adapter answers for {member}"
            remedy = "is its adapter host running?"
        case RequestTimeout():
            code, text = "no-answer", f"{member} has not answered {verb} within {timeout_s:g} s"
            remedy = "look at its adapter host and its link (`tutti trace`)"
        case ValidationError():
            code, text = "bad-reply", f"{member}'s answer to {verb} can not be read: {error}"
        case _:
            text = f"{member} does not understand {verb}: {error}"
    return Refusal(code=code, text=text, remedy=remedy, member=member)
