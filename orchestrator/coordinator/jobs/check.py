"""Check a job before it is accepted, wherever its axes will be then."""

import asyncio
from collections.abc import Generator, Mapping, Sequence

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.executor import Executor, run_inline
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import format_place
from orchestrator.model.jobs.forecast import StepForecast, StepProblem
from orchestrator.model.jobs.parts import find_long_paths
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.order import RemainingStep
from orchestrator.plan.forecast.job import JobForecaster

STEPS_AT_ONCE = 20  # that are checked before other work gets its turn
MAX_LISTED = 10  # problems in one refusal


async def check_job(fleet: Fleet, steps: Sequence[RemainingStep], plan: Executor, check: Executor) -> float:
    """Run steps forward, from an unknown beginning; return how long they take at least, s. More passes and points cost
    no more. plan: plans paths. check: checks all steps if one is a long path, whose plan takes a gigabyte.

    Raises `Refusal` for what cannot work wherever the axes are.
    """
    if find_long_paths([step for _, _, step in steps]):
        return await check(check_at_once, fleet, steps)
    forecaster, least_s = JobForecaster(fleet), 0.0
    for count, (_, number, step) in enumerate(steps):
        if count and count % STEPS_AT_ONCE == 0:
            await asyncio.sleep(0)
        least_s += (await forecast_step(forecaster, number, step, plan)).least_s
    _require_no_problems(steps, forecaster.problems)
    return least_s


def check_at_once(fleet: Fleet, steps: Sequence[RemainingStep]) -> float:
    """The same without a turn for other work, in a process of its own. Raises `Refusal`."""
    forecaster, least_s = JobForecaster(fleet), 0.0
    for _, number, step in steps:
        forecaster, forecast = forecast_at_once(forecaster, number, step)
        least_s += forecast.least_s
    _require_no_problems(steps, forecaster.problems)
    return least_s


def forecast_at_once(forecaster: JobForecaster, number: int, step: Step) -> tuple[JobForecaster, StepForecast]:
    """`forecast_step` without a turn for other work, in a process of its own; the forecaster as it is afterwards."""
    work = forecaster.take_in_parts(number, step)
    while (forecast := _advance(work)) is None:
        pass
    return forecaster, forecast


def predict_s(fleet: Fleet, step: Step) -> float:
    """How long a step without a plan of its own takes, s: a homing or a probe as long as it may, a dwell its duration;
    0 for others."""
    if step.searches or step.probes:
        return JobForecaster(fleet).take(0, step).most_s or 0.0
    return 0.0 if step.acts else (step.pause_ns or 0) / NS_PER_S


async def forecast_step(forecaster: JobForecaster, number: int, step: Step, plan: Executor) -> StepForecast:
    """Run one step forward, with breaks for other work. plan: plans paths, beside which heartbeats and stops go on."""
    work, parts_done = forecaster.take_in_parts(number, step), 0
    advance = plan if any(written_step.plans_long for written_step in step.iterate_written()) else run_inline
    while True:
        forecast = await advance(_advance, work)
        if forecast is not None:
            return forecast
        parts_done += 1
        if parts_done % STEPS_AT_ONCE == 0:
            await asyncio.sleep(0)


def _advance(work: Generator[None, None, StepForecast]) -> StepForecast | None:
    """One part of the work; the forecast after the last one."""
    try:
        next(work)
    except StopIteration as end:
        return end.value
    return None


def _require_no_problems(remaining: Sequence[RemainingStep], problems: list[StepProblem]) -> None:
    """Raise `Refusal` with the first problems."""
    if not problems:
        return
    first, steps = problems[0], {number: step for _, number, step in remaining}
    lines = [f"{_describe_place(steps, problem.place)}: {problem.text}" for problem in problems[:MAX_LISTED]]
    if len(problems) > MAX_LISTED:
        lines.append(f"and {len(problems) - MAX_LISTED} more; see `tutti job check`")
    raise Refusal(first.code, "\n".join(lines), first.remedy, first.controller)


def _describe_place(steps: Mapping[int, Step], place: Sequence[str | int]) -> str:
    """The step that a place is in, with what it does: `steps[2].steps[0] (move)`."""
    step, path = steps[int(place[1])], [*place[:2]]
    for key, number in zip(place[2::2], place[3::2], strict=False):
        if step.inner is None or key != step.inner.key or not isinstance(number, int):
            break
        step = step.inner.steps[number]
        path += [key, number]
    return f"{format_place(path)} ({step.kind})"
