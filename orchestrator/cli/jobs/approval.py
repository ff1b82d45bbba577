"""`tutti job plan` and `approve`: what a proposed job would do, and its release."""

import re
import sys
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, print_result, with_fleet
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.jobs import job_argument, name_jobs
from orchestrator.cli.base.terminal import confirm_shown
from orchestrator.model.steps.numbers import number_step

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.operation.approval import JobPlan, JobPlanned
    from orchestrator.model.report import QueueEntry

MAX_SHOWN_STEPS = 20
_HASH = re.compile(r"(?:sha256:)?([0-9a-f]{8,64})")


@click.command(epilog="Example: tutti job plan 3f2a91c0")
@job_argument
@fleet_options
@json_option
def plan(job: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Show what a waiting JOB would do if it began now: targets, limits, configuration, and where that matters, where
    its axes are. Nothing changes."""

    async def show_plan(tutti: "Tutti") -> None:
        entry = await tutti.find_job(job)
        planned_job = await tutti.plan_job(entry.id)
        if as_json:
            print_json(planned_job.to_plain())
        else:
            await _print_plan(tutti, entry, planned_job)

    with_fleet(connect, fleet, show_plan)


@click.command(epilog="Example: tutti job approve 3f2a91c0 --plan sha256:9b1c04d2")
@job_argument
@click.option("--plan", "seen", metavar="HASH", default=None, help="The plan that was seen, or its first digits.")
@click.option("--yes", is_flag=True, help="Do not ask for confirmation after showing the plan.")
@fleet_options
@json_option
def approve(job: str, seen: str | None, connect: str, fleet: str | None, *, yes: bool, as_json: bool) -> None:
    """Approve the plan of a proposed JOB, and release it.

    The job begins only if it then does exactly this. If something has changed, it is held again, with what changed.
    """
    digits = None if seen is None else _HASH.fullmatch(seen)
    if seen is not None and digits is None:
        exit_with_error(f"{seen!r} is no hash of a plan", BAD_INPUT, "copy it from `tutti job plan`: sha256:9b1c04d2")
    if digits is None and not yes and (as_json or not (sys.stdin.isatty() and sys.stdout.isatty())):
        exit_with_error(
            "without a terminal for the confirmation, give --plan or --yes", BAD_INPUT, "look at it: `tutti job plan`"
        )

    async def approve_job(tutti: "Tutti") -> None:
        entry = await tutti.find_job(job)
        planned_job = await tutti.plan_job(entry.id)
        assert planned_job.plan is not None
        if digits is not None:
            plan_hash = _find_wanted(digits[1], planned_job.plan, entry.id)
        else:
            plan_hash = planned_job.plan.hash
            if not as_json:
                await _print_plan(tutti, entry, planned_job)
            if not yes and not confirm_shown("approve this plan?"):
                console.print("nothing is approved")
                return
        await tutti.approve_job(entry.id, plan_hash)
        words = f"{name_jobs(entry)} is approved: {plan_hash}"
        print_result({"job_id": entry.id, "plan": plan_hash}, words, as_json=as_json)

    with_fleet(connect, fleet, approve_job)


def _find_wanted(digits: str, plan: "JobPlan", job_id: str) -> str:
    """The whole hash that these digits mean; the command ends if the plan of now has another one."""
    if len(digits) == len(plan.hash.partition(":")[2]):
        return f"sha256:{digits}"  # the coordinator knows what has changed since that plan was shown
    if not plan.hash.startswith(f"sha256:{digits}"):
        text = f"the plan of job {job_id} is another one now: {plan.hash}"
        exit_with_error(text, FAILED, f"look at it again: `tutti job plan {job_id}`", code="plan-changed")
    return plan.hash


async def _print_plan(tutti: "Tutti", entry: "QueueEntry", planned: "JobPlanned") -> None:
    from orchestrator.model.steps.order import StepOrder
    from orchestrator.monitor.times import localize_times

    assert planned.plan is not None
    shown_job = (await tutti.show_job(entry.id)).job
    lines = [f"{name_jobs(entry)} of {entry.actor}: {localize_times(entry.reason)}"]
    steps = list(StepOrder(shown_job.steps).iterate_written()) if shown_job is not None else []
    lines += [f"  {number_step(index)} {step.describe()}" for index, step in steps[:MAX_SHOWN_STEPS]]
    lines += [f"  and {len(steps) - MAX_SHOWN_STEPS} more steps"] if len(steps) > MAX_SHOWN_STEPS else []
    lines += ["plan:", *(f"  {name}: {text}" for name, text in planned.plan.parts.items())]
    lines += [f"changed since it was approved: {change}" for change in planned.changed]
    for line in [*lines, planned.plan.hash]:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
