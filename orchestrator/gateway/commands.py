"""Requests of users that go on to the fleet: each is written to the gateway's own log, with user and address.

A stop is in the log before it is sent, and is reported to every open page.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from orchestrator.bus.decoding import MAX_AT_ONCE
from orchestrator.bus.log import ProcessLog
from orchestrator.bus.service_verbs import CONTROLLER_VERBS, SERVICE_VERBS
from orchestrator.client import Tutti
from orchestrator.clock.base import Clock
from orchestrator.clock.executor import Executor, run_inline
from orchestrator.gateway.access.identity import Identity
from orchestrator.gateway.access.refusals import describe_refusal
from orchestrator.gateway.service_requests import PreparedRequest, make_request, prepare_body, prepare_fields
from orchestrator.model.base import Model
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import RawReply, RawRequest

MAX_CONNECTIONS = 256  # actors whose connection is kept
MAX_KEYS = 10_000  # idempotency keys
ANSWER_S = {"submit": 120.0, "dry-run": 60.0, "reload": 60.0, "check-wiring": 60.0, "prune": 60.0}
USUAL_ANSWER_S = 5.0

ShowStop = Callable[[str, str, dict[str, Any]], None]


class _UsedKey(NamedTuple):
    """An idempotency key: the digest of its first body, of which user that was, and when."""

    body: str
    actor: str
    utc: str


class FleetCommands:
    """Passes requests on. on_stop: called with what every page shows of a stop."""

    def __init__(self, tutti: Tutti, clock: Clock, log: ProcessLog, decode: Executor, on_stop: ShowStop) -> None:
        """decode: for requests that take long to read."""
        self.known_controllers: Callable[[], list[str]] = list
        self._tutti, self._clock, self._log, self._decode, self._on_stop = tutti, clock, log, decode, on_stop
        self._connections: OrderedDict[str, Tutti] = OrderedDict()
        self._keys: OrderedDict[str, _UsedKey] = OrderedDict()

    def connect(self, identity: Identity) -> Tutti:
        """The connection with the actor of a user."""
        actor = identity.actor
        connection = self._connections.get(actor)
        if connection is None:
            connection = Tutti(self._tutti.bus, self._tutti.keys.fleet, actor, self._tutti.new_id)
            self._connections[actor] = connection
            if len(self._connections) > MAX_CONNECTIONS:
                self._connections.popitem(last=False)
        self._connections.move_to_end(actor)
        return connection

    async def stop(self, what: str, tutti: Tutti, reason: str) -> dict[str, Any]:
        """Stop the fleet: `stop` by ramps, with the running jobs, or `estop`. Needs no coordinator."""
        self._log.warning(f"{what} by {tutti.actor}", verb=what, actor=tutti.actor, reason=reason)
        answers: dict[str, Refusal | None]
        if what == "estop":
            latched_estop = await tutti.estop(reason or "on the operators' page")
            answers = {name: None if is_latched else _NOT_LATCHED for name, is_latched in latched_estop.items()}
        else:
            answers = await tutti.stop(known=self.known_controllers())
        plain = {name: None if answer is None else describe_refusal(answer) for name, answer in answers.items()}
        self._on_stop(what, tutti.actor, plain)
        return {"answers": plain}

    async def reset(self, identity: Identity) -> dict[str, Any]:
        """Release the e-stop latch on all controllers, and clear faults."""
        self._note(identity, "reset", "")
        answers = await self.connect(identity).reset()
        return {
            "answers": {name: None if answer is None else describe_refusal(answer) for name, answer in answers.items()}
        }

    async def request(self, identity: Identity, verb: str, fields: Mapping[str, Any], key: str = "") -> Model:
        """Pass a request of `svc/{verb}` on. key: an idempotency key; the same one is the same request.

        Raises `Refusal`: codes `bad-request`, `key-used`, and those of the fleet.
        """
        identity.require_right(verb)
        request_id = self._find_request_id(identity, verb, repr(sorted(fields.items())).encode(), key)
        return await self._send(identity, verb, prepare_fields(verb, fields, request_id, identity))

    async def request_body(self, identity: Identity, verb: str, body: bytes, key: str = "") -> Model:
        """The same, of a body that was not read. A large one is read in another process. Raises `Refusal`."""
        identity.require_right(verb)
        prepare = self._decode if len(body) > MAX_AT_ONCE else run_inline
        request_id = self._find_request_id(identity, verb, body, key)
        return await self._send(identity, verb, await prepare(prepare_body, verb, body, request_id, identity))

    async def _send(self, identity: Identity, verb: str, prepared: PreparedRequest) -> Model:
        service, tutti = SERVICE_VERBS[verb], self.connect(identity)
        if not service.reads:
            self._note(identity, verb, prepared.subject)
        return await tutti.request_service(verb, prepared.payload, service.reply, ANSWER_S.get(verb, USUAL_ANSWER_S))

    async def request_controller(
        self, identity: Identity, verb: str, controller: str, fields: Mapping[str, Any]
    ) -> Model:
        """Send a command to one controller; one in its own language that names no `holder`, as `tutti raw` does, with
        all its axes acquired meanwhile. Raises `Refusal`."""
        identity.require_right(verb)
        service, tutti = CONTROLLER_VERBS[verb], self.connect(identity)
        is_alone = verb == "raw" and "holder" not in fields
        given_fields = {**fields, "holder": ""} if is_alone else fields
        request = make_request(service, given_fields, tutti.new_id(), identity.actor)
        if not service.reads:
            self._note(identity, verb, controller)
        if is_alone and isinstance(request, RawRequest):
            return RawReply(reply=await tutti.send_raw(controller, request.command, i_know=request.i_know))
        return await tutti.request_controller(controller, verb, request, service.reply)

    def _find_request_id(self, identity: Identity, verb: str, content: bytes, key: str) -> str:
        """The id of a request with an idempotency key; without one, a new one. A key is of its user, at whichever
        computer that is. content: tells one request from another."""
        if not key:
            return self._tutti.new_id()
        request_id = hashlib.sha256(f"{identity.user or identity.role} {verb} {key}".encode()).hexdigest()[:40]
        body = hashlib.sha256(content).hexdigest()
        used_key = self._keys.setdefault(request_id, _UsedKey(body, identity.actor, self._clock.utc()))
        if used_key.body != body:
            text = (
                f"the idempotency key {key[:60]!r} was used at {used_key.utc} by {used_key.actor} for another request"
            )
            raise Refusal("key-used", text, "use a new key for each request, and the same only to repeat it")
        if len(self._keys) > MAX_KEYS:
            self._keys.popitem(last=False)
        return request_id

    def _note(self, identity: Identity, verb: str, subject: str) -> None:
        text = f"{verb} {subject}".rstrip()
        self._log.info(f"{text} by {identity.actor}", verb=verb, actor=identity.actor, subject=subject)


_NOT_LATCHED = Refusal("not-latched", "the controller reports no e-stop", "use the wired e-stop")
