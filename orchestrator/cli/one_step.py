"""Manual actions as jobs of one step, so that they are leased, checked, recorded and stopped like any other job.

They end with the command: see `orchestrator.cli.foreground`.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import console, exit_with_error, with_fleet

F = TypeVar("F", bound=Callable[..., Any])


def wait_option(command: F) -> F:
    """Add the option `--wait`."""
    return click.option(
        "--wait", is_flag=True, help="Wait for axes that are in use, instead of being refused; shows what it waits for."
    )(command)


def run_single_step(connect: str, fleet: str | None, step: dict[str, Any], done: str, *, wait: bool = False) -> None:
    """Submit a job of one step, wait for it, and print `done` or its reason. Exit 1 if it is not done.

    wait: let it wait for axes that are in use. An interrupt stops what the step moves.
    """
    from pydantic import ValidationError

    from orchestrator.cli.foreground import run_attended
    from orchestrator.client import Tutti
    from orchestrator.model.job import Job

    try:
        job = Job.model_validate({"schema": "tutti.job/1", "name": f"manual: {step['do']}", "steps": [step]})
    except ValidationError as error:
        exit_with_error(str(error.errors()[0]["msg"]), BAD_INPUT)

    async def submit_step(tutti: Tutti) -> None:
        report = await run_attended(tutti, job, wait=wait, quiet=not console.is_terminal)
        if report.state != "done":
            exit_with_error(report.steps[-1].reason if report.steps else report.reason or report.state, FAILED)
        console.print(done)

    with_fleet(connect, fleet, submit_step)
