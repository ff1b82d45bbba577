"""Requests to members. Each failure on the way becomes a refusal: a value that names the member.

Requests to several members on one adapter host go in one batch request (`request_all`), which the host answers for
all of them; stops do not, because a stop must not wait for another controller.
"""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypedDict, TypeVar

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusError, NoReply, OtherServer, RequestRefused, RequestTimeout
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.fleet.batches import HostBatches
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.leadership.leadership import Leadership
from orchestrator.model.messages import BatchReply, RefusalDetails, Reply, Request

R = TypeVar("R", bound=Reply)

ANSWER_S = 2.0
"""An adapter that has not answered a small request by then hangs."""
TRY_S = 0.3
"""For one try of a repeated request: the usual answer to a stop takes a tenth of that."""
RETRY_PAUSE_S = 0.05
MAX_UNDER_WAY = 16
"""Hosts that are asked at once."""
ABSENT_S = 0.7
"""An adapter that is alive but has not received a heartbeat for half a second has stopped by itself by then."""


class FencedFields(TypedDict):
    """Fields that every fenced request has."""

    request_id: str
    actor: str
    epoch: int
    coordinator: str


@dataclass(frozen=True, slots=True)
class MemberRequests:
    """Sends requests to controllers on the bus, with the epoch of this leadership. Since the adoption of a controller
    only the replies of the process that answered for it then count."""

    bus: Bus
    keys: FleetKeys
    leadership: Leadership
    new_id: Callable[[], str]
    view: FleetView

    def request_fields(self, actor: str) -> FencedFields:
        """Fields that every fenced request has."""
        return {
            "request_id": self.new_id(),
            "actor": actor,
            "epoch": self.leadership.epoch,
            "coordinator": self.leadership.coordinator,
        }

    async def request(self, member: str, verb: str, request: Request, reply: type[R], timeout_s: float) -> R:
        """Send `request` to `member` and return its reply; one with `refused` set if there is no valid reply."""
        try:
            return await self._request_reply(member, verb, request, reply, timeout_s)
        except (BusError, ValidationError) as error:
            return reply(refused=self._make_refusal(member, verb, error, timeout_s))

    async def repeat_request(self, member: str, verb: str, request: Request, reply: type[R], timeout_s: float) -> R:
        """Repeat `request` for `timeout_s`: where something moves, a bus that was away for a moment (its router
        restarts) must not lose the request. It is executed once, because it keeps its id.

        If no adapter is found, that ends after `ABSENT_S`.
        """
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        while True:
            try:
                return await self._request_reply(member, verb, request, reply, TRY_S)
            except (BusError, ValidationError) as error:
                unheard = isinstance(error, NoReply | RequestTimeout)
                longest_s = ABSENT_S if isinstance(error, NoReply) else timeout_s
                if not unheard or loop.time() - begun_s >= longest_s:
                    return reply(refused=self._make_refusal(member, verb, error, timeout_s))
            await asyncio.sleep(RETRY_PAUSE_S)

    async def request_all(
        self,
        verb: str,
        requests: Mapping[str, Request],
        reply: type[R],
        timeout_s: float = ANSWER_S,
        answered: Callable[[str, int], None] | None = None,
    ) -> dict[str, R]:
        """Send requests to several members; return the replies by member. Hosts are asked at once, `MAX_UNDER_WAY` of
        them, so that a slow one delays no other. answered: called with each member that has answered, and the ns that
        it took."""
        servers: dict[tuple[str, str | None], dict[str, Request]] = {}
        for member, request in requests.items():
            server = (self._host_of(member), self.view.servers.get(member))
            servers.setdefault(server, {})[member] = request

        async def ask(asked: Mapping[str, Request]) -> dict[str, tuple[R, int]]:
            if len(asked) > 1:
                return await self._request_batch(verb, asked, reply, timeout_s)
            begun_s = asyncio.get_running_loop().time()
            ((member, request),) = asked.items()
            answer = await self.request(member, verb, request, reply, timeout_s)
            return {member: (answer, _elapsed_ns(begun_s))}

        places = asyncio.Semaphore(MAX_UNDER_WAY)

        async def ask_in_turn(asked: Mapping[str, Request]) -> dict[str, tuple[R, int]]:
            async with places:
                return await ask(asked)

        answers: dict[str, tuple[R, int]] = {}
        for part in await asyncio.gather(*map(ask_in_turn, servers.values())):
            answers |= part
        if answered is not None:
            for member, (_, took_ns) in answers.items():
                answered(member, took_ns)
        return {member: answers[member][0] for member in requests}

    async def repeat_all(self, verb: str, requests: Mapping[str, Request], reply: type[R]) -> dict[str, R]:
        """Send requests to several members at once, each separately and repeated as by `repeat_request`; return the
        replies by member."""
        answers = await asyncio.gather(*(self.repeat_request(m, verb, r, reply, ANSWER_S) for m, r in requests.items()))
        return dict(zip(requests, answers, strict=True))

    async def _request_batch(
        self, verb: str, requests: Mapping[str, Request], reply: type[R], timeout_s: float
    ) -> dict[str, tuple[R, int]]:
        """Send a batch request to the members of one host. By member that has answered: its reply, and how long it
        took."""
        begun_s = asyncio.get_running_loop().time()
        texts = {member: request.to_json().decode() for member, request in requests.items()}
        first = next(iter(requests))
        host = (self._host_of(first), self.view.servers.get(first))
        batches, batch, failure = HostBatches(self.bus, self.keys), BatchReply(), None
        try:
            batch = await batches.ask(host, verb, texts, timeout_s)
        except (BusError, ValidationError) as error:
            failure = error
        took_ns = _elapsed_ns(begun_s)
        # The time on the bus was the same for all.
        both_ways_ns = took_ns - max(batch.took_ns.values(), default=took_ns)

        def of(member: str) -> R:
            try:
                if failure is not None:
                    raise failure
                if member in batch.errors:
                    raise RequestRefused(batch.errors[member])
                if member not in batch.replies:
                    raise RequestTimeout(batches.make_key(host[0], verb))
                return reply.read_message(batch.replies[member])
            except (BusError, ValidationError) as error:
                return reply(refused=self._make_refusal(member, verb, error, timeout_s))

        return {member: (of(member), batch.took_ns.get(member, took_ns) + both_ways_ns) for member in requests}

    async def _request_reply(self, member: str, verb: str, request: Request, reply: type[R], timeout_s: float) -> R:
        key, server = self.keys.command(member, verb), self.view.servers.get(member)
        return reply.read_message(await self.bus.request(key, request.to_json(), timeout_s, server))

    def _make_refusal(
        self, member: str, verb: str, error: BusError | ValidationError, timeout_s: float
    ) -> RefusalDetails:
        if isinstance(error, NoReply) and self.view.describe_slow_start(member) is not None:
            return RefusalDetails.of(self.view.make_absence(member, str(error)))
        return _make_refusal(member, verb, error, timeout_s)

    def _host_of(self, member: str) -> str:
        return self.view.fleet.controllers[member].host


def _elapsed_ns(begun_s: float) -> int:
    return round((asyncio.get_running_loop().time() - begun_s) * NS_PER_S)


def _make_refusal(member: str, verb: str, error: BusError | ValidationError, timeout_s: float) -> RefusalDetails:
    code, remedy = "bad-request", ""
    match error:
        case OtherServer():
            code, text = "other-instance", f"{member} is answered by another process than the one that was adopted"
            remedy = "its adapter host has restarted, or something else serves its keys; see its log"
        case NoReply():
            code, text = "absent", f"no adapter answers for {member}"
            remedy = "check that its adapter host is running"
        case RequestTimeout():
            code, text = "no-answer", f"{member} has not answered {verb} within {timeout_s:g} s"
            remedy = "check its adapter host and its link (`tutti trace`)"
        case ValidationError():
            code, text = "bad-reply", f"{member}'s answer to {verb} cannot be read: {error}"
        case _:
            text = f"{member} does not accept {verb}: {error}"
    return RefusalDetails(code=code, text=text, remedy=remedy, member=member)
