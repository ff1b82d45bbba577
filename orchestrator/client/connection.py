"""The connection to one fleet: the bus, the keys, and requests to the leader and to controllers."""

import asyncio
import uuid
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any, Self, TypeVar

from pydantic import ValidationError

from orchestrator.bus.base import (
    Bus,
    BusError,
    BusSample,
    DoubleServer,
    NoReply,
    RequestRefused,
    RequestTimeout,
    find_only_server,
)
from orchestrator.bus.endpoint import DEFAULT_ENDPOINT
from orchestrator.bus.fleets import find_fleets
from orchestrator.bus.identity import find_session_identity
from orchestrator.bus.keys import ANY_KEPT_ESTOP, FleetKeys
from orchestrator.bus.service_verbs import NOT_LEADER
from orchestrator.bus.states.feed import Arrival, ControllerFeed
from orchestrator.bus.states.frame import Confirmation
from orchestrator.client.slow_starts import explain_absence
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.base import Model
from orchestrator.model.errors import NotAllowed, Refusal
from orchestrator.model.messages import Reply, Request
from orchestrator.model.problems import first_error_text

M = TypeVar("M", bound=Model)

ANSWER_S = 3.0
CHECKED_BYTES_S = 50_000  # a path of 100,000 pieces, 7 MB, takes 50 s to be planned on a free core
LEADER_S = 1.0  # for the leader to say that it leads
LOOK_S = 0.05  # between two looks for it, while two say so


class FollowedSamples:
    """A `FeedReceiver` with a queue. queue: the samples in their order, with the keys of their controllers.
    on_confirmed: called with what a host says of its controllers, when it says it."""

    def __init__(self, queue: asyncio.Queue[BusSample]) -> None:
        self.queue = queue
        self.on_confirmed: Callable[[Mapping[str, Confirmation]], None] = lambda _: None

    def take_arrival(self, arrival: Arrival) -> None:
        """Queue the samples of a message."""
        for sample in arrival.samples:
            self.queue.put_nowait(sample)
        if arrival.confirmations:
            self.on_confirmed(arrival.confirmations)

    def take_bad_frame(self, text: str) -> None:
        """Leave it out: the coordinator logs it."""


class FleetConnection:
    """A connection to one fleet; use it as a context.

    connect: the router, e.g. `tcp/127.0.0.1:7447`, or a bus. fleet: its name; None: the only one on the bus. actor:
    the user or program that makes the requests, for journals and logs.
    """

    def __init__(
        self,
        connect: str | Bus = DEFAULT_ENDPOINT,
        fleet: str | None = None,
        actor: str = "api",
        new_id: Callable[[], str] = lambda: uuid.uuid4().hex,
    ) -> None:
        self._endpoint = connect if isinstance(connect, str) else ""
        self._bus = None if isinstance(connect, str) else connect
        self._loop: asyncio.AbstractEventLoop | None = None
        self._keys = None if fleet is None else FleetKeys(fleet)
        self._close_listeners = set[Callable[[], None]]()
        self._leader = ""  # as the bus names the process that has answered last
        self.actor = actor
        self.new_id = new_id

    def __repr__(self) -> str:
        fleet = "not connected" if self._keys is None else self._keys.fleet
        return f"<{type(self).__name__} {fleet} at {self._endpoint or 'a bus'}, as {self.actor}>"

    async def open(self) -> Self:
        """Connect; entering the context does it. Raises `RouterUnreachable`, and `Refusal` with code `no-fleet` or
        `which-fleet`."""
        from orchestrator.bus.zenoh.bus import open_bus

        if self._bus is None:
            self._bus = await open_bus(self._endpoint)
            self._loop = asyncio.get_running_loop()
        if self._keys is None:
            try:
                self._keys = FleetKeys(await find_only_fleet(self._bus))
            except BaseException as error:
                await self.close()
                if isinstance(error, Refusal) and error.code == "no-fleet":
                    raise await self._explain_silence(error, "status") from None
                raise
        return self

    @property
    def bus(self) -> Bus:
        """The bus. Raises `RuntimeError` before `open`, and in another event loop than that of `open`."""
        if self._bus is None:
            raise RuntimeError("not connected; use it as `async with Tutti(…) as tutti:`")
        if self._loop not in (None, asyncio.get_running_loop()):
            raise RuntimeError("connected in another event loop; open a Tutti in this one, or use BlockingTutti")
        return self._bus

    @property
    def keys(self) -> FleetKeys:
        """The keys of the fleet. Raises `RuntimeError` before `open`."""
        if self._keys is None:
            raise RuntimeError("not connected; use it as `async with Tutti(…) as tutti:`")
        return self._keys

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Disconnect. Safe to call twice."""
        for listener in list(self._close_listeners):
            listener()
        bus, self._bus = self._bus, None
        if bus is not None:
            await bus.close()

    @asynccontextmanager
    async def subscribe_samples(self, *expressions: str) -> AsyncGenerator[asyncio.Queue[BusSample]]:
        """A queue that receives every sample on the given key expressions while the context lasts."""
        queue: asyncio.Queue[BusSample] = asyncio.Queue()
        subscriptions = [await self.bus.subscribe(expression, queue.put_nowait) for expression in expressions]
        try:
            yield queue
        finally:
            for declaration in subscriptions:
                await declaration.undeclare()

    @asynccontextmanager
    async def follow_all(self, *expressions: str) -> AsyncGenerator[FollowedSamples]:
        """What `subscribe_samples` gives, and what all controllers publish, from the frames of their hosts."""
        async with self.subscribe_samples(*expressions) as queue:
            samples, loop = FollowedSamples(queue), asyncio.get_running_loop()
            feed = ControllerFeed(self.bus, self.keys, lambda: round(loop.time() * NS_PER_S), samples)
            await feed.start()
            try:
                yield samples
            finally:
                await feed.close()

    def request_fields(self) -> dict[str, Any]:
        """The fields that every request has."""
        return {"request_id": self.new_id(), "actor": self.actor}

    async def request_service(
        self, verb: str, request: Request | bytes, reply: type[M], timeout_s: float = ANSWER_S
    ) -> M:
        """Send a request, or the JSON of one, to the leader and return its reply; of another process no reply counts.

        Raises `Refusal`."""
        key = self.keys.service(verb)
        try:
            if self._leader:
                try:
                    return await self._ask(key, request, reply, timeout_s, self._leader)
                except NoReply:
                    pass  # then another coordinator leads now
                except RequestRefused as error:
                    if str(error) != NOT_LEADER:
                        raise
                    # What the leader has accepted already, it answers again.
            self._leader = await self._find_leader(min(timeout_s, LEADER_S))
            return await self._ask(key, request, reply, timeout_s, self._leader)
        except BusError as error:
            self._leader = ""
            text = f"fleet {self.keys.fleet} has no active coordinator"
            failure = _explain_failure(error, Refusal("no-coordinator", text, "start one: `tutti up FILE`"))
            if isinstance(error, NoReply):
                failure = await self._explain_silence(failure, verb, self.keys.leader_answer())
            raise failure from None

    async def _find_leader(self, timeout_s: float) -> str:
        """The process that leads. One that was overtaken may say so of itself for a moment. Raises `BusError`."""
        until_s = asyncio.get_running_loop().time() + timeout_s
        while True:
            try:
                return await find_only_server(self.bus, self.keys.leader_answer(), timeout_s)
            except DoubleServer:
                if asyncio.get_running_loop().time() > until_s:
                    raise
            await asyncio.sleep(LOOK_S)

    async def _explain_silence(self, absent: Refusal, verb: str, served: str = "") -> Refusal:
        """The refusal for an empty answer: a router with roles leaves out what a name may not do, without a word.

        absent: if nothing is left out. served: a key that every reader may ask, served by the process that should have
        answered. The router serves one itself: where not even that answers, the name has no right at all.
        """
        identity = find_session_identity(self._endpoint)
        if identity is None:
            return absent
        name = identity.common_name
        if served and await self._is_answered(served):
            text, remedy = f"its role may not do `{verb}`", "use the identity of a role that may: `tutti keys ls`"
        elif await self._is_answered(ANY_KEPT_ESTOP):
            return absent
        else:
            text = "not even the router answers it"
            remedy = f"see `tutti keys ls`: does {name} count, and may its role look? Else copy its folder again"
        return NotAllowed(absent.code, f"not allowed as {name}: {text}", remedy, absent.controller)

    async def _is_answered(self, expression: str) -> bool:
        try:
            return bool(await self.bus.request_all(expression, b"", LEADER_S))
        except BusError:
            return False

    async def find_absence(self) -> Refusal:
        """The refusal, code `no-fleet`, for a fleet of which no controller answers; names the fleets that do."""
        fleets = await find_fleets(self.bus)
        if self.keys.fleet in fleets:
            text = f"no controller of fleet {self.keys.fleet} answers"
            return Refusal("no-fleet", text, "are its adapter hosts running? see `tutti up`")
        fleet_list = f"there are: {', '.join(fleets)}" if fleets else "no fleet is on this bus"
        remedy = "choose one with --fleet" if fleets else "start it: `tutti up FILE`"
        absent = Refusal("no-fleet", f"no fleet {self.keys.fleet}; {fleet_list}", remedy)
        return await self._explain_silence(absent, "status")

    async def request_controller(
        self, controller: str, verb: str, request: Request, reply: type[M], timeout_s: float = ANSWER_S
    ) -> M:
        """Send a command to a controller's adapter and return its reply.

        Raises `Refusal`; its text names the controller, because adapters know only their own axis names.
        """
        try:
            return await self._ask(self.keys.command(controller, verb), request, reply, timeout_s)
        except BusError as error:
            failure = _explain_failure(error, absence_refusal(controller))
            if isinstance(error, NoReply):
                if verb != "stop":  # that reports at once which controllers have it
                    failure = await explain_absence(self.bus, self.keys, failure)
                failure = await self._explain_silence(failure, verb, self.keys.state(controller))
            raise failure from None
        except Refusal as error:
            if error.controller != controller or controller in error.text:
                raise
            raise Refusal(error.code, f"{controller}: {error.text}", error.remedy, controller) from None

    async def _request(self, key: str, request: Request, reply: type[M], timeout_s: float, absent: Refusal) -> M:
        try:
            return await self._ask(key, request, reply, timeout_s)
        except BusError as error:
            failure = _explain_failure(error, absent)
            if isinstance(error, NoReply) and absent.controller is not None:
                failure = await explain_absence(self.bus, self.keys, failure)
            raise failure from None

    async def _ask(
        self, key: str, request: Request | bytes, reply: type[M], timeout_s: float, server: str | None = None
    ) -> M:
        """Raises `BusError`, and `Refusal` if the answer is one or cannot be read."""
        payload = request if isinstance(request, bytes) else request.to_json()
        answer = await self.bus.request(key, payload, timeout_s + len(payload) / CHECKED_BYTES_S, server)
        try:
            received_message = reply.read_message(answer)
        except ValidationError as error:
            text = f"the answer on {key} cannot be read: {first_error_text(error)}"
            raise Refusal("bad-reply", text, "use the same version of Tutti everywhere") from None
        if isinstance(received_message, Reply) and received_message.refused is not None:
            raise received_message.refused.as_error()
        return received_message


def _explain_failure(error: BusError, absent: Refusal) -> Refusal:
    """The refusal for a request that got no answer. absent: if no process serves its key."""
    match error:
        case NoReply():
            return absent
        case DoubleServer():
            text = f"{error}; none of them was asked to do anything"
            return Refusal("several-servers", text, "end the one that should not be on the bus")
        case RequestTimeout():
            return Refusal("no-answer", str(error), "check whether that process hangs")
        case _:
            return Refusal("bad-request", str(error))


async def find_only_fleet(bus: Bus) -> str:
    """The name of the only fleet on the bus. Raises `Refusal`, code `no-fleet` or `which-fleet`."""
    fleets = await find_fleets(bus)
    if len(fleets) == 1:
        return fleets[0]
    if not fleets:
        raise Refusal("no-fleet", "no fleet is on this bus", "start one: `tutti up FILE`")
    text = f"several fleets are on this bus: {', '.join(fleets)}"
    raise Refusal("which-fleet", text, "choose one with --fleet")


def absence_refusal(controller: str) -> Refusal:
    """The refusal for a controller without an adapter on the bus."""
    return Refusal(
        "absent",
        f"no adapter answers for controller {controller}",
        "see `tutti status` for those that are there",
        controller,
    )
