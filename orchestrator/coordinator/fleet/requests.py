"""Requests to members. Whatever goes wrong on the way becomes a refusal: a value that names the member.

Several members on one adapter host are asked in one request (`ask_all`), which its host answers for all of them; stops
are not, because nobody's stop is to wait for another's.
"""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypedDict, TypeVar

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusError, NoReply, RequestRefused, RequestTimeout
from orchestrator.bus.keys import Keys
from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.leadership.leadership import Throne
from orchestrator.model.messages import Refusal, Reply, Request, Together, TogetherReply

R = TypeVar("R", bound=Reply)

ANSWER_S = 2.0
"""An adapter that has not answered a small request by then is hung."""
TRY_S = 0.3
"""For one try of what is insisted on: the usual answer to a stop takes a tenth of that."""
AGAIN_S = 0.05
HOST_PART = 0.9
"""Of the time that its members have, in which an adapter host says who has answered; the rest is for its own answer."""
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
    """Asks controllers on the bus, in the name of this reign. host: names the adapter host of a controller."""

    bus: Bus
    keys: Keys
    throne: Throne
    new_id: Callable[[], str]
    host: Callable[[str], str]

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
        answered: Callable[[str, int], None] | None = None,
    ) -> dict[str, R]:
        """`ask` several members, or `insist`, all at once; the replies by member. answered: told of each when it has
        answered, by how many ns after it was asked."""
        hosts: dict[str, dict[str, Request]] = {}
        for member, request in requests.items():
            # Who is insisted on is asked alone.
            hosts.setdefault(member if insist else self.host(member), {})[member] = request

        async def ask(asked: Mapping[str, Request]) -> dict[str, tuple[R, int]]:
            if len(asked) > 1:
                return await self._ask_together(verb, asked, reply, timeout_s)
            begun_s = asyncio.get_running_loop().time()
            ((member, request),) = asked.items()
            said = await (self.insist if insist else self.ask)(member, verb, request, reply, timeout_s)
            return {member: (said, _since_ns(begun_s))}

        found: dict[str, tuple[R, int]] = {}
        for each in await asyncio.gather(*map(ask, hosts.values())):
            found |= each
        if answered is not None:
            for member, (_, took_ns) in found.items():
                answered(member, took_ns)
        return {member: found[member][0] for member in requests}

    async def _ask_together(
        self, verb: str, requests: Mapping[str, Request], reply: type[R], timeout_s: float
    ) -> dict[str, tuple[R, int]]:
        """Ask members of one host. By member: its reply, and how long it took, as far as it has answered."""
        begun_s = asyncio.get_running_loop().time()
        texts = {member: request.to_json().decode() for member, request in requests.items()}
        asked = Together(requests=texts, within_ns=round(HOST_PART * timeout_s * NS_PER_S))
        key = self.keys.together(self.host(next(iter(requests))), verb)
        said, failure = TogetherReply(), None
        try:
            said = TogetherReply.model_validate_json(await self.bus.request(key, asked.to_json(), timeout_s))
        except (BusError, ValidationError) as error:
            failure = error
        took_ns = _since_ns(begun_s)
        # The way there and back was the same for all.
        both_ways_ns = took_ns - max(said.took_ns.values(), default=took_ns)

        def of(member: str) -> R:
            try:
                if failure is not None:
                    raise failure
                if member in said.errors:
                    raise RequestRefused(said.errors[member])
                if member not in said.replies:
                    raise RequestTimeout(key)
                return reply.model_validate_json(said.replies[member])
            except (BusError, ValidationError) as error:
                return reply(refused=_refusal(member, verb, error, timeout_s))

        return {member: (of(member), said.took_ns.get(member, took_ns) + both_ways_ns) for member in requests}

    async def _answer(self, member: str, verb: str, request: Request, reply: type[R], timeout_s: float) -> R:
        payload = await self.bus.request(self.keys.cmd(member, verb), request.to_json(), timeout_s)
        return reply.model_validate_json(payload)


def _since_ns(begun_s: float) -> int:
    return round((asyncio.get_running_loop().time() - begun_s) * NS_PER_S)


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
