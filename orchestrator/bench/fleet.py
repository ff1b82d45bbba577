"""A live fleet for measurements: simulated controllers that record their motions, everything else real."""

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Awaitable, Callable
from dataclasses import replace
from pathlib import Path

from orchestrator.bench.truth import POLL_S, TIMEOUT_S, NothingHappened
from orchestrator.client import Tutti
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.live import raw_ns
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.runtime.live.fleet import LiveFleet, find_free_port
from orchestrator.runtime.live.run import FleetRun, WebOptions

Steps = list[dict[str, object]]


@contextlib.asynccontextmanager
async def run_measured_fleet(
    fleet: Fleet,
    state: Path,
    *,
    standby: bool = False,
    web: WebOptions | None = None,
    timeout_s: float = TIMEOUT_S,
) -> AsyncGenerator[tuple[LiveFleet, Tutti]]:
    """Run `fleet` while the context is open, with its controllers adopted. timeout_s: of the wait for that. Raises
    `UpFailed`, `Refusal`, `NothingHappened`."""
    run = replace(FleetRun.make_simulated(find_free_port()), standby=standby, web=web)
    live = LiveFleet(fleet, state, lambda _: None, run)
    await live.start()
    try:
        async with Tutti(live.connect, fleet.fleet, "bench") as tutti:

            async def all_adopted() -> bool:
                states = (await tutti.status()).values()
                return len(states) == len(fleet.controllers) and all(s.epoch and s.mode == "idle" for s in states)

            await wait_until(all_adopted, "all controllers are adopted", timeout_s)
            yield live, tutti
    finally:
        await live.close()


async def wait_until(condition: Callable[[], Awaitable[bool]], what: str, timeout_s: float = TIMEOUT_S) -> None:
    """Wait for an action of another process. Raises `NothingHappened`."""
    try:
        async with asyncio.timeout(timeout_s):
            asked_ns = raw_ns()
            while not await condition():
                # A question to many takes long: the answers are not to keep this computer busy.
                await asyncio.sleep(max(POLL_S, (raw_ns() - asked_ns) / NS_PER_S))
                asked_ns = raw_ns()
    except TimeoutError:
        raise NothingHappened(f"not within {timeout_s:g} s: {what}") from None


async def submit_steps(tutti: Tutti, steps: Steps) -> str:
    """Submit a job of `steps` and return its id. Raises `Refusal`."""
    return await tutti.submit(Job.model_validate({"schema": "tutti.job/1", "name": "benchmark", "steps": steps}))


async def run_steps(tutti: Tutti, steps: Steps) -> None:
    """Run a job that must complete. Raises `Refusal`, `NothingHappened`."""
    report = await tutti.wait_for_job(await submit_steps(tutti, steps), poll_s=0.1)
    if report.state != "done":
        raise NothingHappened(f"the benchmark's job is {report.state}: {report.reason}")
