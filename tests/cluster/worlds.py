"""Fleets and jobs that the cluster tests share."""

from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, TypeVar

from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.lab.virtual import VirtualFleet
from orchestrator.model.files import load_fleet, load_job, parse
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import Job

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
T = TypeVar("T")


def demo_fleet() -> Fleet:
    """The example fleet: SMC-4000 on TCP, SHRC-203 on a serial line."""
    return load_fleet(EXAMPLES / "demo.fleet.yaml")


def demo_job() -> Job:
    return load_job(EXAMPLES / "demo.job.yaml")


def job(steps: str, **fields: str) -> Job:
    """A job from YAML steps."""
    head = "".join(f"{name}: {value}\n" for name, value in fields.items())
    return parse(f"schema: tutti.job/1\nname: test\n{head}steps: {steps}\n", Job, "test")


PREPARE = job("[{do: enable, axes: [gantry, stage]}, {do: home}]")
MOVE = job(
    "[{do: move, to: {gantry.x: 300, gantry.y: 50, stage.u: 12, stage.focus: 2000}, speed: 0.15}]"
)  # some ten seconds: nobody is there by chance


def run_fleet(main: Callable[[VirtualFleet], Coroutine[Any, Any, T]], fleet: Fleet | None = None, seed: int = 1) -> T:
    """Run `main` with a started virtual fleet."""

    async def run(clock: VirtualClock) -> T:
        virtual = VirtualFleet(fleet or demo_fleet(), clock, seed)
        await virtual.start()
        return await main(virtual)

    return run_virtual(run)
