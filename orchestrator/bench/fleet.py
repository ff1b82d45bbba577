"""A live fleet for measurements: simulated controllers that record their motions, everything else real."""

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Awaitable, Callable
from pathlib import Path

from orchestrator.bench.truth import GIVE_UP_S, LOOK_S, NothingHappened
from orchestrator.client import Tutti
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import Job
from orchestrator.runtime.live import LiveFleet, free_port

Steps = list[dict[str, object]]


@contextlib.asynccontextmanager
async def measured_fleet(fleet: Fleet, state: Path, standby: bool = False) -> AsyncGenerator[tuple[LiveFleet, Tutti]]:
    """Run `fleet` while the context is open, with its controllers adopted. Raises `UpFailed`, `Refusal`,
    `NothingHappened`."""
    live = LiveFleet(fleet, state, lambda _: None, port=free_port(), simulated=True, truth=True, standby=standby)
    await live.start()
    try:
        async with Tutti(live.connect, fleet.fleet, "bench") as tutti:

            async def adopted() -> bool:
                states = (await tutti.status()).values()
                return len(states) == len(fleet.controllers) and all(s.epoch and s.mode == "idle" for s in states)

            await until(adopted, "all controllers are adopted")
            yield live, tutti
    finally:
        await live.close()


async def until(condition: Callable[[], Awaitable[bool]], what: str) -> None:
    """Wait for an action of another process. Raises `NothingHappened`."""
    try:
        async with asyncio.timeout(GIVE_UP_S):
            while not await condition():
                await asyncio.sleep(LOOK_S)
    except TimeoutError:
        raise NothingHappened(f"not within {GIVE_UP_S:g} s: {what}") from None


async def submit(tutti: Tutti, steps: Steps) -> str:
    """Submit a job of `steps` and return its id. Raises `Refusal`."""
    return await tutti.submit(Job.model_validate({"schema": "tutti.job/1", "name": "benchmark", "steps": steps}))


async def run_steps(tutti: Tutti, steps: Steps) -> None:
    """Run a job that must complete. Raises `Refusal`, `NothingHappened`."""
    report = await tutti.wait_for_job(await submit(tutti, steps), poll_s=0.1)
    if report.state != "done":
        raise NothingHappened(f"the benchmark's job is {report.state}: {report.reason}")
