"""Requests of users that go on to the fleet: each is written to the gateway's own log, with user and address.

A stop is in the log before it is sent, and is reported to every open page.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, cast

from pydantic import ValidationError

from orchestrator.bus.log import ProcessLog
from orchestrator.bus.service_verbs import CONTROLLER_VERBS, SERVICE_VERBS, ServiceVerb
from orchestrator.client import Tutti
from orchestrator.clock.base import Clock
from orchestrator.clock.executor import Executor
from orchestrator.gateway.access.identity import Identity
from orchestrator.gateway.access.refusals import describe_refusal
from orchestrator.gateway.access.roles import may
from orchestrator.model.base import Model
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import SubmitJob
from orchestrator.model.messages import RawReply, RawRequest, Request
from orchestrator.model.problems import read_problems

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

    def __init__(self, tutti: Tutti, clock: Clock, log: ProcessLog, execute: Executor, on_stop: ShowStop) -> None:
        self.known_controllers: Callable[[], list[str]] = list
        self._tutti, self._clock, self._log, self._execute, self._on_stop = tutti, clock, log, execute, on_stop
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
        service, tutti = SERVICE_VERBS[verb], self.connect(identity)
        request_id = self._find_request_id(identity, verb, fields, key)
        given_fields = {"client_key": request_id, **fields} if "client_key" in service.request.model_fields else fields
        # In a thread: the model of a long job takes a tenth of a second, in which a jog would not be renewed.
        request = await self._execute(make_request, service, given_fields, request_id, identity.actor)
        if isinstance(request, SubmitJob):
            request = prepare_submission(request, identity)
        if not service.reads:
            self._note(identity, verb, _describe_subject(fields))
        return await tutti.request_service(verb, request, service.reply, ANSWER_S.get(verb, USUAL_ANSWER_S))

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

    def _find_request_id(self, identity: Identity, verb: str, fields: Mapping[str, Any], key: str) -> str:
        """The id of a request with an idempotency key; without one, a new one. A key is of its user, at whichever
        computer that is."""
        if not key:
            return self._tutti.new_id()
        request_id = hashlib.sha256(f"{identity.user or identity.role} {verb} {key}".encode()).hexdigest()[:40]
        body = hashlib.sha256(repr(sorted(fields.items())).encode()).hexdigest()
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


def make_request(verb: ServiceVerb, fields: Mapping[str, Any], request_id: str, actor: str) -> Request:
    """A request of its fields. Raises `Refusal`, code `bad-request`, with every mistake."""
    reserved_names = [name for name in ("request_id", "actor") if name in fields]
    if reserved_names:
        raise Refusal(
            "bad-request", f"{reserved_names[0]} is given by the gateway", "leave it out; see `Idempotency-Key`"
        )
    try:
        return verb.request.model_validate({**fields, "request_id": request_id, "actor": actor})
    except ValidationError as error:
        texts = [problem.describe("body") for problem in read_problems(error)[:10]]
        raise Refusal("bad-request", "; ".join(texts), "see /v1/openapi.json for the fields") from None


def prepare_submission(request: SubmitJob, identity: Identity) -> SubmitJob:
    """A submission as the role of its user allows it: jobs of a proposer wait for approval. The job's actor is the
    user, whatever the file says."""
    job = request.job.model_copy(update={"actor": identity.actor})
    terms = request.terms.model_copy(update={"session": None})
    if not may(identity.role, "approve"):
        terms = terms.model_copy(update={"proposed": True, "now": False, "priority": 0})
    return request.model_copy(update={"job": job, "terms": terms})


def _describe_subject(fields: Mapping[str, Any]) -> str:
    """What a request is about, in a few words."""
    for name in ("job_id", "job_ids", "alarm_id", "alarm_ids", "name", "axes"):
        value = fields.get(name)
        if value:
            return str(value)[:100]
    job = fields.get("job")
    return str(cast(Mapping[str, object], job).get("name", ""))[:100] if isinstance(job, dict) else ""
