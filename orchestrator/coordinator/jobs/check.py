"""Check a job before it is accepted, wherever its axes will be then."""

import asyncio

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.forecast import StepProblem
from orchestrator.model.job import Step
from orchestrator.plan.forecast import JobForecaster

STEPS_AT_ONCE = 20  # that are checked before other work gets its turn
MAX_LISTED = 10  # problems in one refusal


async def check_job(fleet: Fleet, steps: list[Step], repeat: int = 1, first: int = 0) -> None:
    """Run all steps from number `first` on forward, from an unknown beginning.

    Raises `Refusal` for what cannot work wherever the axes are.
    """
    forecaster = JobForecaster(fleet)
    for number in range(first, len(steps) * repeat):
        if number and number % STEPS_AT_ONCE == 0:
            await asyncio.sleep(0)
        forecaster.take(number % len(steps), steps[number % len(steps)])
    if forecaster.problems:
        raise _make_refusal(steps, forecaster.problems)


def _make_refusal(steps: list[Step], problems: list[StepProblem]) -> Refusal:
    first = problems[0]
    lines = [f"steps[{each.place[1]}] ({steps[int(each.place[1])].do}): {each.text}" for each in problems[:MAX_LISTED]]
    if len(problems) > MAX_LISTED:
        lines.append(f"and {len(problems) - MAX_LISTED} more; see `tutti job check`")
    return Refusal(first.code, "\n".join(lines), first.remedy, first.controller)
