"""Requests to the fleet, made of the bodies of HTTP requests within their budgets.

A large body is read and checked in another process, and passed on as it came out of it: 4 MB took half a second to
check here, in which no stop and no jog was answered.
"""

import json
import re
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

from pydantic import ValidationError

from orchestrator.bus.budgets import COMMAND_BUDGETS, SERVICE_BUDGETS, STOP, USUAL, WorkBudget
from orchestrator.bus.service_verbs import SERVICE_VERBS, ServiceVerb
from orchestrator.gateway.access.identity import Identity
from orchestrator.gateway.access.roles import may
from orchestrator.gateway.replies import RefusedRequest
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.parts import dump_long
from orchestrator.model.jobs.service import SubmitJob
from orchestrator.model.messages import Request
from orchestrator.model.problems import read_problems

FILE_TEXT = WorkBudget(4_000_000, 400_000, 400_000, "split the job, or read the file on a computer of the fleet")
"""Of a body with the text of a file."""
_HALF_PAIR = re.compile(rb"\\u[dD][89a-fA-F]")
_BODIES = {"check-job": FILE_TEXT, "check-fleet": FILE_TEXT, "estop": STOP, "reset": STOP}


class PreparedRequest(NamedTuple):
    """A request as it is sent. subject: what it is about, in a few words."""

    payload: bytes
    subject: str


def require_body_budget(verb: str, body: bytes) -> None:
    """Raises `RefusedRequest` for a body with more than a request of this verb can need."""
    budget = _BODIES.get(verb) or SERVICE_BUDGETS.get(verb) or COMMAND_BUDGETS.get(verb, USUAL)
    excess = budget.find_excess(body)
    if excess:
        raise RefusedRequest(413, Refusal("too-large", excess, budget.remedy))


def read_fields(body: bytes) -> dict[str, Any]:
    """The fields of a body. Raises `Refusal`."""
    try:
        value: object = json.loads(body) if body else {}
        if _HALF_PAIR.search(body):
            json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        text = f"a text of the body has {error.object[error.start]!a}, which is half of a character"
        raise Refusal("bad-request", text, "send texts in UTF-8") from None
    except (ValueError, RecursionError):
        raise Refusal("bad-request", "the body is no JSON", "send a JSON object") from None
    if not isinstance(value, dict):
        raise Refusal("bad-request", "the body is no JSON object", "send the fields of the request in an object")
    return cast(dict[str, Any], value)


def prepare_body(verb: str, body: bytes, request_id: str, identity: Identity) -> PreparedRequest:
    """A request of its body. Raises `Refusal`."""
    return prepare_fields(verb, read_fields(body), request_id, identity)


def prepare_fields(verb: str, fields: Mapping[str, Any], request_id: str, identity: Identity) -> PreparedRequest:
    """A request of its fields. Raises `Refusal`."""
    service = SERVICE_VERBS[verb]
    given_fields = {"client_key": request_id, **fields} if "client_key" in service.request.model_fields else fields
    request = make_request(service, given_fields, request_id, identity.actor)
    if isinstance(request, SubmitJob):
        request = prepare_submission(request, identity)
    return PreparedRequest(dump_long(request), _describe_subject(fields))


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
