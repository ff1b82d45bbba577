"""Manual actions as jobs of one step, so that they are leased, checked, recorded and stopped like any other job."""

from typing import Any

from orchestrator.cli.codes import BAD_INPUT, FAILED
from orchestrator.cli.common import console, fail, with_fleet


def run_step(connect: str, fleet: str | None, step: dict[str, Any], done: str) -> None:
    """Submit a job of one step, wait for it, and print `done` or its reason. Exit 1 if it is not done."""
    from pydantic import ValidationError

    from orchestrator.cli.follow import follow
    from orchestrator.client import Tutti
    from orchestrator.model.job import Job

    try:
        job = Job.model_validate({"schema": "tutti.job/1", "name": f"manual: {step['do']}", "steps": [step]})
    except ValidationError as error:
        fail(str(error.errors()[0]["msg"]), BAD_INPUT)

    async def act(tutti: Tutti) -> None:
        report = await follow(tutti, await tutti.submit(job), quiet=not console.is_terminal)
        if report.state != "done":
            fail(report.steps[-1].reason if report.steps else report.reason or report.state, FAILED)
        console.print(done)

    with_fleet(connect, fleet, act)
