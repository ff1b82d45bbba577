"""Steps that wait armed: what starts them, what ends the wait, and how long it is from `go` to T0."""

from random import Random
from statistics import median

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, origin_host_ns, outcome, refusal, run_fleet

from orchestrator.client.api import Tutti
from orchestrator.client.jobs import SubmittedJob
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Permit
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import FINISHED_STATES, JobProgress, JobReport, JobState, QueueEntry, StepReport
from orchestrator.runtime.virtual.fleet import VirtualFleet


def armed_job(targets: str, terms: str = "") -> Job:
    return job(f"[{{do: wait_armed{terms}}}, {{do: move, to: {{{targets}}}}}]")


THERE = armed_job("gantry.x: 20, gantry.y: 10, stage.u: 4")


async def find_entry(client: Tutti, submitted: SubmittedJob) -> tuple[QueueEntry, JobProgress | None]:
    shown = await client.show_job(submitted)
    assert shown.entry is not None
    return shown.entry, shown.progress


async def submit_armed(fleet: VirtualFleet, armed: Job = THERE) -> SubmittedJob:
    """Submit a job; return once its step waits armed."""
    client = fleet.make_client()
    submitted = await client.submit(armed)
    while True:
        entry, progress = await find_entry(client, submitted)
        assert entry.state not in FINISHED_STATES, entry.reason
        if progress is not None and progress.armed is not None:
            return submitted
        await sleep_ns(fleet.clock, 5 * NS_PER_MS)


BACK = armed_job("gantry.x: 0, gantry.y: 0, stage.u: 1")
KNOWN = job(
    "[{do: repeat, times: 9, steps: [{do: move, to: {gantry.x: 10, stage.u: 2}, start: agreed}, "
    "{do: home, axes: [stage.focus]}, {do: move, to: {gantry.x: 0, stage.u: 1}, start: agreed}, "
    "{do: home, axes: [stage.focus]}]}]"
)


def is_moving(fleet: VirtualFleet) -> bool:
    return any(unit.is_moving(axis) for unit in fleet.controllers.values() for axis in unit.axis_names)


def motion_counts(fleet: VirtualFleet) -> dict[str, int]:
    return {name: len(unit.commanded_motions) for name, unit in fleet.controllers.items()}


async def find_loaded(fleet: VirtualFleet) -> list[str]:
    """The controllers that hold a step, by their states."""
    states = await fleet.make_client().status()
    return [name for name, state in states.items() if state.mode in ("armed", "committed", "moving")]


async def set_door(fleet: VirtualFleet, *, active: bool) -> None:
    """Open (active) or close the door; return when its controller has reported it."""
    fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=not active))
    await fleet.wait_until(lambda states: states["gantry"].inputs["door"] == active)


async def go_refused(submitted: SubmittedJob) -> str:
    """The code of the refusal of `go`."""
    with pytest.raises(Refusal) as refused:
        await submitted.go()
    return refused.value.code


async def wait_for_state(fleet: VirtualFleet, submitted: SubmittedJob, state: JobState) -> None:
    client = fleet.make_client()
    while (await find_entry(client, submitted))[0].state != state:
        await sleep_ns(fleet.clock, 5 * NS_PER_MS)


async def ended(submitted: SubmittedJob) -> JobReport:
    report = await submitted.wait()
    assert isinstance(report, JobReport)
    return report


def moved(report: JobReport) -> StepReport:
    return report.steps[-1]


def test_go_starts_all_members_within_the_promise() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        submitted = await submit_armed(fleet)
        await sleep_ns(fleet.clock, 3 * NS_PER_S)
        assert not is_moving(fleet) and fleet.journal.list_decisions(submitted.id) == []
        t0_ns = await submitted.go()
        report = await ended(submitted)
        assert report.state == "done", report.reason
        step = moved(report)
        assert step.t0_fleet_ns == t0_ns and step.verdict == "green" and step.waited_armed is not None
        assert step.waited_armed.by == "request" and step.waited_armed.lead_ns < 200 * NS_PER_MS, step.waited_armed

    run_fleet(main)


@pytest.mark.parametrize("waits", [3, pytest.param(1000, marks=pytest.mark.nightly)])
def test_go_to_t0_takes_one_start_lead(waits: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        draw, leads_ms = Random(5), list[float]()
        await outcome(fleet, PREPARE)
        await outcome(fleet, KNOWN)  # what this fleet needs is known then
        for number in range(waits):
            submitted = await submit_armed(fleet, BACK if number % 2 else THERE)
            await sleep_ns(fleet.clock, draw.randrange(59 * NS_PER_S))
            await submitted.go()
            report = await ended(submitted)
            assert report.state == "done" and moved(report).verdict != "red", report
            wait = moved(report).waited_armed
            assert wait is not None
            leads_ms.append(wait.lead_ns / NS_PER_MS)
        assert median(leads_ms) <= 60.0, sorted(leads_ms)

    run_fleet(main)


def test_the_wait_has_an_end() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        refused = await refusal(fleet, armed_job("gantry.x: 20", ", timeout: 3 s"))
        assert refused.code == "wait-timeout" and "3 s" in refused.text

    run_fleet(main)


def test_an_input_starts_it_by_its_edge_alone() -> None:
    by_door = armed_job("stage.u: 4", ", input: gantry.door")

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        await set_door(fleet, active=True)
        refused = await refusal(fleet, by_door)
        assert refused.code == "input-active" and "level: true" in refused.remedy
        await set_door(fleet, active=False)
        submitted = await submit_armed(fleet, by_door)
        await sleep_ns(fleet.clock, NS_PER_S)
        await set_door(fleet, active=True)
        report = await ended(submitted)
        wait = moved(report).waited_armed
        assert report.state == "done" and wait is not None and wait.by == "input"
        level = armed_job("stage.u: 1", ", input: gantry.door, level: true")
        assert (await outcome(fleet, level)).state == "done"

    run_fleet(main)


def test_a_second_go_is_refused_and_one_after_the_end() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        submitted = await submit_armed(fleet)
        await submitted.go()
        assert await go_refused(submitted) == "begun"
        await ended(submitted)
        assert await go_refused(submitted) == "ended"

    run_fleet(main)


def test_an_instant_is_met_or_refused_and_it_stays_armed() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        submitted = await submit_armed(fleet)
        origin_ns = origin_host_ns(fleet)
        for ahead_ns in (-NS_PER_S, 10 * NS_PER_MS):
            with pytest.raises(Refusal, match="nearest possible is") as refused:
                await submitted.go(fleet.clock.now_ns() - origin_ns + ahead_ns)
            assert refused.value.code == "too-near"
        with pytest.raises(Refusal, match="after the end of the wait"):
            await submitted.go(fleet.clock.now_ns() - origin_ns + 100 * NS_PER_S)
        at_ns = fleet.clock.now_ns() - origin_ns + 31 * NS_PER_S  # the members are armed anew meanwhile
        assert await submitted.go(at_ns) == at_ns
        assert await go_refused(submitted) == "begun"
        step = moved(await ended(submitted))
        assert step.state == "done" and step.t0_fleet_ns is not None and 0 <= step.t0_fleet_ns - at_ns < 2 * NS_PER_MS

    run_fleet(main)


def test_a_pause_ends_the_wait_and_it_waits_anew() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        submitted = await submit_armed(fleet)
        await submitted.pause()
        await wait_for_state(fleet, submitted, "paused")
        assert await go_refused(submitted) == "not-armed"
        await sleep_ns(fleet.clock, NS_PER_S)
        assert await find_loaded(fleet) == []
        await submitted.resume()
        await wait_for_state(fleet, submitted, "armed")
        await sleep_ns(fleet.clock, NS_PER_S)
        assert not is_moving(fleet)
        await submitted.go()
        assert (await ended(submitted)).state == "done"

    run_fleet(main)


async def stop(fleet: VirtualFleet, _: SubmittedJob) -> None:
    await fleet.make_client().stop()


async def estop(fleet: VirtualFleet, _: SubmittedJob) -> None:
    await fleet.make_client().estop("test")


async def cancel(_: VirtualFleet, submitted: SubmittedJob) -> None:
    await submitted.cancel()


async def lose_permit(fleet: VirtualFleet, _: SubmittedJob) -> None:
    """For a moment: it holds again at once."""
    await set_door(fleet, active=True)
    await set_door(fleet, active=False)


async def kill_host(fleet: VirtualFleet, _: SubmittedJob) -> None:
    fleet.kill("host/local")
    await sleep_ns(fleet.clock, NS_PER_S)
    fleet.start_host("local")


async def move_by_another_client(fleet: VirtualFleet, _: SubmittedJob) -> None:
    link = await fleet.wires["gantry"].open_link()
    link.write(b"PRX=500;BGX\r")
    await sleep_ns(fleet.clock, NS_PER_S)
    await link.close()


async def meet_limit(fleet: VirtualFleet, _: SubmittedJob) -> None:
    fleet.act_on_controller("gantry", lambda gantry: gantry.set_limit("X", "forward"))


CAUSES = {
    "stop": stop,
    "estop": estop,
    "cancel": cancel,
    "permit": lose_permit,
    "restart": kill_host,
    "limit": meet_limit,
    "another client": move_by_another_client,
}


@pytest.mark.parametrize("cause", CAUSES)
def test_what_ends_the_wait_starts_nothing_later(cause: str) -> None:
    permit = Permit(input="gantry.door", value=False)
    guarded = demo_fleet().model_copy(update={"permits": {"door-closed": permit}})

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        submitted = await submit_armed(fleet)
        await sleep_ns(fleet.clock, NS_PER_S)
        await CAUSES[cause](fleet, submitted)
        begun = motion_counts(fleet)
        report = await ended(submitted)
        assert report.state in ("failed", "aborted", "cancelled"), report
        assert await go_refused(submitted) == "ended"
        await sleep_ns(fleet.clock, 30 * NS_PER_S)
        assert motion_counts(fleet) == begun and await find_loaded(fleet) == []
        assert fleet.journal.list_decisions(submitted.id) == []

    run_fleet(main, guarded)
