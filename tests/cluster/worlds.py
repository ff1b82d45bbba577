"""Fleets and jobs that the cluster tests share."""

import asyncio
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, TypeVar

from orchestrator.bus.base import BusSample
from orchestrator.client.api import Tutti
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet, parse_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.restart import StartPreview
from orchestrator.model.messages import RefusalDetails
from orchestrator.model.queue import QueueTerms, StartPolicy
from orchestrator.model.report import JobProgress, JobReport, LeaseState
from orchestrator.model.templates.template import load_job
from orchestrator.runtime.virtual.fleet import VirtualFleet

LONGEST_S = 600  # of fleet time: a job that takes longer waits for something that does not come
EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
T = TypeVar("T")


def demo_fleet() -> Fleet:
    """The example fleet: SMC-4000 on TCP, SHRC-203 on a serial line; without its named positions, because tests change
    its axes, and with the lead times that it learns."""
    return load_fleet(EXAMPLES / "demo.fleet.yaml").model_copy(update={"positions": {}, "starts": StartPolicy()})


def virtual_demo_fleet() -> Fleet:
    """The example fleet, with virtual axes of its gantry."""
    axes = {"u": {"unit": "mm"}, "v": {"unit": "mm"}}
    turned = {"kind": "rotation", "of": ["gantry.x", "gantry.y"], "axes": axes, "angle": 30}
    return Fleet.model_validate(demo_fleet().to_plain() | {"virtual": {"turned": turned}})


def drive_fleet(name: str, active: str = "high", number: int = 2, **simulate: object) -> Fleet:
    """The example fleet with a CiA 402 drive `lift`. name, active, number: of its input. simulate: options."""
    plain = demo_fleet().to_plain()
    plain["controllers"]["lift"] = {
        "adapter": "cia402",
        "link": {"kind": "can", "interface": "socketcan", "channel": "can0", "address": 3},
        "axes": {
            "z": {
                "motors": ["1"],
                "unit": "mm",
                "scale": 1000,
                "limits": {"velocity": 50, "acceleration": 500},
                "homing": {"speed": 5},
            }
        },
        "inputs": {name: {"number": number, "active": active}},
        "simulate": {"options": simulate},
    }
    return Fleet.model_validate(plain)


def line_fleet(controller: str) -> Fleet:
    """The controllers of one link of the example fleet with all makes."""
    plain = load_fleet(EXAMPLES / "all.fleet.yaml").to_plain()
    link = plain["controllers"][controller]["link"]
    plain["controllers"] = {
        name: config
        for name, config in plain["controllers"].items()
        if {**config["link"], "address": 0} == {**link, "address": 0}
    }
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "one", "controllers": plain["controllers"]})


def demo_job() -> Job:
    return load_job(EXAMPLES / "demo.job.yaml")


def job(steps: str, **fields: str) -> Job:
    """A job from YAML steps."""
    head = "".join(f"{name}: {value}\n" for name, value in fields.items())
    return parse_document(f"schema: tutti.job/1\nname: test\n{head}steps: {steps}\n", Job, "test")


PREPARE = job("[{do: enable, axes: [gantry, stage]}, {do: home}]")
MOVE = job(
    "[{do: move, to: {gantry.x: 300, gantry.y: 50, stage.u: 12, stage.focus: 2000}, speed: 0.15}]"
)  # some ten seconds: no position is reached by chance


def run_fleet(
    main: Callable[[VirtualFleet], Coroutine[Any, Any, T]],
    fleet: Fleet | None = None,
    seed: int = 1,
    wired: Fleet | None = None,
) -> T:
    """Run `main` with a started virtual fleet. wired: the real wiring, if it differs from the fleet file."""

    async def run(clock: VirtualClock) -> T:
        virtual = VirtualFleet(fleet or demo_fleet(), clock, seed, wired=wired)
        await virtual.start()
        return await main(virtual)

    return run_virtual(run)


def changed(fleet: Fleet, **controllers: dict[str, Any]) -> Fleet:
    """`fleet` with fields of its controllers replaced; `axes` and `simulate` are merged one level deeper."""
    plain = fleet.to_plain()
    for name, fields in controllers.items():
        target = plain["controllers"][name]
        for field, value in fields.items():
            if field == "axes":
                for axis, more in value.items():
                    target["axes"][axis] |= more
            elif field == "simulate":
                target["simulate"]["options"] |= value
            else:
                target[field] = value
    return Fleet.model_validate(plain)


def origin_host_ns(fleet: VirtualFleet) -> int:
    """The host instant at which fleet time is 0."""
    return next(iter(fleet.coordinators.values()))[1].leadership.scale.origin_host_ns


async def first_leases_ns(fleet: VirtualFleet, client: Tutti, controller: str) -> dict[str, int]:
    """By holder, when `controller` was leased to them first; filled from now on."""
    leased_ns: dict[str, int] = {}

    def look(sample: BusSample) -> None:
        holder = LeaseState.model_validate_json(sample.payload).holder
        leased_ns.setdefault(holder or "", fleet.clock.now_ns())

    await client.bus.subscribe(fleet.keys.lease(controller), look)
    return leased_ns


def rested(fleet: VirtualFleet, controller: str, at_ns: int) -> bool:
    """Whether every motion of `controller` that started before `at_ns` had ended by then."""
    made = fleet.controllers[controller].commanded_motions
    return all(each.end_ns is not None and each.end_ns <= at_ns for each in made if each.start_ns < at_ns)


async def give_word(_: StartPreview) -> bool:
    """An operator for whom everything that is shown may begin."""
    return True


async def outcome(fleet: VirtualFleet, *jobs: Job) -> JobReport:
    """Run jobs one after the other, with an operator who starts the queue; the report of the last one."""
    client = fleet.make_client()
    report = None
    for each in jobs:
        await client.start_queue()
        job_id = await client.submit(each)
        try:
            async with asyncio.timeout(LONGEST_S):
                report = await client.wait_for_job(job_id, on_ready=give_word)
        except TimeoutError:
            shown = (await client.show_job(job_id)).entry
            raise AssertionError(f"not ended within {LONGEST_S} s: {shown}") from None
    assert report is not None
    return report


async def wait_for_point(fleet: VirtualFleet, job_id: str, point: int) -> None:
    """Wait until a job works on a point of a scan, counted from 1, or on one behind it."""
    client, reached = fleet.make_client(), asyncio.Event()

    def look(sample: BusSample) -> None:
        if (JobProgress.model_validate_json(sample.payload).point or 0) >= point:
            reached.set()

    subscription = await client.bus.subscribe(client.keys.job_state(job_id), look)
    async with asyncio.timeout(60):
        await reached.wait()
    await subscription.undeclare()


async def refusal(fleet: VirtualFleet, *jobs: Job) -> RefusalDetails:
    """The refusal of the last of `jobs`, or of its last step. It may not wait for the world."""
    *before, last = jobs
    if before:
        await outcome(fleet, *before)
    client = fleet.make_client()
    await client.start_queue()
    try:
        report = await client.wait_for_job(await client.submit(last, terms=QueueTerms(now=True)))
    except Refusal as error:
        return RefusalDetails.of(error)
    refused = report.steps[-1].refused
    assert refused is not None
    return refused


async def begin_ready(client: Tutti, *job_ids: str) -> None:
    """Wait until these jobs are ready to begin, or wait behind others, after a cause; then give the word for them."""
    while not any(entry is not None and entry.ready for entry in [(await client.show_job(i)).entry for i in job_ids]):
        await asyncio.sleep(0.1)
    await client.start_queue()
