"""Manual actions as jobs of one step, so that they are leased, checked, recorded and stopped like any other job."""

from typing import Any

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import console, exit_with_error, with_fleet


def run_single_step(connect: str, fleet: str | None, step: dict[str, Any], done: str) -> None:
    """Submit a job of one step, wait for it, and print `done` or its reason. Exit 1 if it is not done."""
    from pydantic import ValidationError

    from orchestrator.cli.follow import follow_job
    from orchestrator.client import Tutti
    from orchestrator.model.job import Job

    try:
        job = Job.model_validate({"schema": "tutti.job/1", "name": f"manual: {step['do']}", "steps": [step]})
    except ValidationError as error:
        exit_with_error(str(error.errors()[0]["msg"]), BAD_INPUT)

    async def submit_step(tutti: Tutti) -> None:
        report = await follow_job(tutti, await tutti.submit(job), quiet=not console.is_terminal)
        if report.state != "done":
            exit_with_error(report.steps[-1].reason if report.steps else report.reason or report.state, FAILED)
        console.print(done)

    with_fleet(connect, fleet, submit_step)
