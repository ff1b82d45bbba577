"""The program of a live job in the campaign: it asks for all its moves, and ends the job behind them."""

from collections.abc import Sequence

from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.live import AskLive, LiveAsked
from orchestrator.model.jobs.service import JobReference
from orchestrator.model.messages import Reply, Request
from orchestrator.model.steps.base import Step

LOOK_NS = 20 * NS_PER_MS
GIVE_UP_NS = 60 * NS_PER_S


async def run_program(client: Tutti, clock: Clock, job_id: str, steps: Sequence[Step]) -> None:
    """Ask live job `job_id` for `steps` once it runs, then to end behind them; nothing of that if it has ended."""
    until_ns = clock.now_ns() + GIVE_UP_NS
    plain = {**client.request_fields(), "job_id": job_id, "steps": [step.to_plain() for step in steps]}
    requests: list[tuple[str, Request, type[Reply]]] = [
        ("ask-live", AskLive.model_validate(plain), LiveAsked),
        ("end-live", JobReference(**client.request_fields(), job_id=job_id), Reply),
    ]
    for verb, request, reply in requests:
        while clock.now_ns() < until_ns:
            try:
                await client.request_service(verb, request, reply)
                break
            except Refusal as error:
                if error.code == "ended":
                    return
            # It has not begun, or the coordinator is away.
            await sleep_ns(clock, LOOK_NS)
