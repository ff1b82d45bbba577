"""Keys of clients: the same key of the same user is the same job, and never the job of another user.

A user that signs in is one, at whichever computer; a user of the bus is as stated.
"""

import ipaddress
import re
from hashlib import sha256

from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.facts import KeyedJob
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.parts import dump_long
from orchestrator.model.jobs.service import RetryJob, SubmitJob

_GATEWAY_ACTOR = re.compile(r"(?P<user>[a-z0-9][a-z0-9.-]{0,31})(/[a-z0-9][a-z0-9_-]{0,31})?@(?P<address>.+)")


def find_owner(actor: str) -> str:
    """The owner of a key: of `anna@192.0.2.1` and `anna/nightly@192.0.2.7`, as gateways name users, `anna`; of any
    other name, the name as a whole."""
    match = _GATEWAY_ACTOR.fullmatch(actor)
    if match is None:
        return actor
    try:
        ipaddress.ip_address(match["address"])
    except ValueError:
        return actor
    return match["user"]


class ClientKeys:
    """The keys under which jobs were submitted, in the journal: they count after a change of leader too."""

    def __init__(self, services: JobServices) -> None:
        self._services = services

    async def find_job(self, request: SubmitJob | RetryJob) -> KeyedJob | None:
        """The job that was accepted for this request before, if there is one.

        Raises `Refusal`, code `key-used`, if the key was used for another request."""
        services, owner = self._services, find_owner(request.actor)
        job = await services.execute(services.journal.find_keyed_job, owner, request.client_key)
        if job is None or await self._is_same(job, request):
            return job
        text = f"the key {request.client_key[:60]!r} was used at {job.submitted_utc} by {job.actor} for another request"
        remedy = f"use a new key for each job, and the same only to repeat a request; that one is job {job.job_id}"
        raise Refusal("key-used", text, remedy)

    async def _is_same(self, keyed: KeyedJob, request: SubmitJob | RetryJob) -> bool:
        """Whether a job was submitted by this request. A job of schema 10 or before has no digest: its owner's is, and
        another one's if it is the same work, which must not be done twice."""
        if keyed.digest or find_owner(keyed.actor) == find_owner(request.actor):
            return keyed.digest in ("", await self._services.execute(digest_request, request))
        services = self._services
        job = await services.load_job(keyed.job_id)
        return isinstance(request, SubmitJob) and job == request.job.model_copy(update={"actor": keyed.actor})


def digest_request(request: SubmitJob | RetryJob) -> str:
    """SHA-256 of what is asked for: job, terms, steps. Not of its id, or the computer at which its user is."""
    excluded_fields = {"request_id": True, "actor": True, "client_key": True, "job": {"actor"}}
    return sha256(f"{type(request).__name__} ".encode() + dump_long(request, excluded_fields)).hexdigest()
