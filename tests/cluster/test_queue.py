"""The queue: parallel jobs, jobs in order where they need the same axes, and changes by users."""

import asyncio

import pytest
from cluster.worlds import PREPARE, job, outcome, run_fleet

from orchestrator.bus.base import BusSample
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.coordinator.jobs.queue.queue_order import MAX_JOBS_WITHOUT_AXES, WITHOUT_AXES_REASON
from orchestrator.model.errors import Refusal
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import QueueEntry, QueueState
from orchestrator.runtime.virtual.fleet import VirtualFleet

GANTRY = job("[{do: move, to: {gantry.x: 300}, speed: 0.2}, {do: move, to: {gantry.x: 0}, speed: 0.2}]")
STAGE = job("[{do: move, to: {stage.u: 20}, speed: 0.5}]")
BOTH = job("[{do: move, to: {gantry.y: 20, stage.u: 2}}]")
SHORT = job("[{do: move, by: {gantry.y: 1}}]")


async def entry(client: Tutti, job_id: str) -> QueueEntry:
    found = (await client.show_job(job_id)).entry
    assert found is not None
    return found


async def begins(client: Tutti, *job_ids: str) -> list[str]:
    """Ids in the order of their starts."""
    reports = [await client.wait_for_job(each) for each in job_ids]
    assert [each.state for each in reports] == ["done"] * len(reports), [each.reason for each in reports]
    return [each.job_id for each in sorted(reports, key=lambda each: each.started_utc or "")]


def test_jobs_without_a_controller_in_common_run_at_the_same_time() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        first, second = await client.submit(GANTRY), await client.submit(STAGE)
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        # Cancelling one does not touch the other.
        await client.cancel_job(first)
        assert (await client.wait_for_job(first)).state == "cancelled"
        assert (await client.status())["stage"].mode == "moving"
        report = await client.wait_for_job(second)
        assert report.state == "done", report.reason
        assert fleet.controllers["stage"].position("1") == 200_000

    run_fleet(main)


def test_a_wide_job_is_not_starved_by_small_ones() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        running = await client.submit(GANTRY)
        wide = await client.submit(BOTH)
        small = [await client.submit(STAGE), await client.submit(SHORT)]
        await asyncio.sleep(0.5)
        # The stage is free, and reserved for the job that has waited longer.
        assert (await client.status())["stage"].mode == "idle"
        assert (await entry(client, wide)).reason == f"waits for gantry: job 'test' {running} of anna"
        assert (await entry(client, small[0])).reason == f"waits for stage: job 'test' {wide} of anna comes first"
        assert [(await entry(client, each)).place for each in (running, wide, *small)] == [None, 1, 2, 3]
        assert await begins(client, running, wide, *small) == [running, wide, *small]

    run_fleet(main)


def test_a_job_waits_for_a_manual_lease_and_starts_when_it_is_released() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna, ben = fleet.make_client("anna"), fleet.make_client("ben")
        await outcome(fleet, PREPARE)
        heard: list[str] = []

        async with anna.manual_control(["gantry.x"], what="alignment"):
            waiting, free = await ben.submit(BOTH), await ben.submit(job("[{do: dwell, duration: 1 s}]"))

            def receive(sample: BusSample) -> None:
                heard.extend(each.reason for each in QueueState.model_validate_json(sample.payload).jobs)

            await ben.bus.subscribe(ben.keys.queue, receive)
            assert (await ben.wait_for_job(free)).state == "done"
            assert (await entry(ben, waiting)).reason == "waits for gantry: in use by anna (alignment)"
        assert (await ben.wait_for_job(waiting)).state == "done"
        assert "waits for gantry: in use by anna (alignment)" in heard

    run_fleet(main)


def test_priority_hold_release_and_order() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        running = await client.submit(GANTRY)
        a, b, c, d, e = [
            await client.submit(SHORT, terms=terms)
            for terms in (
                QueueTerms(),
                QueueTerms(),
                QueueTerms(priority=5),
                QueueTerms(held=True),
                QueueTerms(priority=-1),
            )
        ]
        await client.reorder_job(e, before=a)
        assert (await entry(client, e)).terms.priority == 0
        await client.hold_jobs(b)
        shown = await entry(client, b)
        assert (shown.reason, shown.held_by) == ("held by anna", "anna")
        assert await begins(client, running, c, e, a) == [running, c, e, a]
        assert [(await entry(client, each)).state for each in (b, d)] == ["queued", "queued"]
        await client.release_jobs(d)
        assert (await client.wait_for_job(d)).state == "done"
        await client.release_jobs()
        report = await client.wait_for_job(b)
        assert [(each.state, each.reason, each.actor) for each in report.transitions[:3]] == [
            ("queued", "submitted", "anna"),
            ("queued", "held by anna", "anna"),
            ("queued", "released by anna", "anna"),
        ]

    run_fleet(main)


def test_a_request_that_does_not_fit_the_state_of_the_job_is_refused() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        running, queued = await client.submit(GANTRY), await client.submit(SHORT)
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        for asked, code in (
            (client.hold_jobs(running), "not-queued"),
            (client.reorder_job(running, before=queued), "not-queued"),
            (client.reorder_job(queued, before=queued), "same-job"),
            (client.pause_job(queued), "not-running"),
            (client.resume_job(queued), "not-running"),
            (client.resume_job(running), "not-paused"),
            (client.retry_job(running), "not-ended"),
            (client.hold_jobs("nothing"), "unknown-job"),
        ):
            with pytest.raises(Refusal) as caught:
                await asked
            assert caught.value.code == code
        await client.cancel_job(running)
        await client.wait_for_job(queued)
        with pytest.raises(Refusal, match="is done already"):
            await client.pause_job(queued)

    run_fleet(main)


def test_after_another_job() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        first = await client.submit(GANTRY)
        then = await client.submit(STAGE, terms=QueueTerms(after=first))
        assert (await entry(client, then)).reason == f"begins when job {first} is done"
        assert await begins(client, first, then) == [first, then]
        late = await client.submit(STAGE, terms=QueueTerms(after=first))
        assert (await client.wait_for_job(late)).state == "done"
        failing = await client.submit(
            job("[{do: dwell, duration: 1 s}, {do: wait, input: gantry.door, timeout: 100 ms}]")
        )
        one = await client.submit(SHORT, terms=QueueTerms(after=failing))
        two = await client.submit(SHORT, terms=QueueTerms(after=one))
        report = await client.wait_for_job(two)
        assert report.state == "cancelled"
        assert report.reason.startswith(f"job {one}, which must be done before, is cancelled: job {failing}")
        assert "did not become active" in report.reason
        for unknown, code in ((failing, "not-done"), ("nothing", "unknown-job")):
            with pytest.raises(Refusal) as caught:
                await client.submit(SHORT, terms=QueueTerms(after=unknown))
            assert caught.value.code == code

    run_fleet(main)


def test_a_job_is_repeated() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        before = fleet.controllers["gantry"].position("Y")
        report = await client.wait_for_job(await client.submit(SHORT, terms=QueueTerms(repeat=3)))
        assert report.state == "done", report.reason
        assert [step.index for step in report.steps] == [0, 1, 2]
        assert fleet.controllers["gantry"].position("Y") == before + 3000
        with pytest.raises(Refusal) as caught:
            await client.submit(GANTRY, terms=QueueTerms(repeat=10_000))
        assert caught.value.text == "2 steps, 10000 times, are 20000; the maximum is 10000"

    run_fleet(main)


def test_pause_at_the_end_of_a_step_and_resume() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna, ben = fleet.make_client("anna"), fleet.make_client("ben")
        await outcome(fleet, PREPARE)
        job_id = await anna.submit(GANTRY)
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        await ben.pause_job(job_id)
        await fleet.wait_until(lambda states: states["gantry"].mode == "idle")
        await asyncio.sleep(5.0)
        shown = await entry(anna, job_id)
        assert shown.state == "paused"
        assert fleet.controllers["gantry"].position("X") == 300_000
        # Its axes stay its own.
        with pytest.raises(Refusal, match="is in use by anna"):
            await ben.manual_control(["gantry.x"]).acquire()
        await anna.resume_job(job_id)
        report = await anna.wait_for_job(job_id)
        assert report.state == "done", report.reason
        holding = next(each for each in report.transitions if each.state == "paused")
        assert (holding.reason, holding.actor) == ("paused by ben after step 1", "ben")
        resumed = report.transitions[report.transitions.index(holding) + 1]
        assert (resumed.state, resumed.reason, resumed.actor) == ("running", "resumed by anna", "anna")

    run_fleet(main)


def test_an_ended_job_is_retried_from_a_step() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        job_id = await client.submit(
            job(
                "[{do: move, to: {gantry.x: 30}}, {do: move, to: {gantry.x: 390}, speed: 0.1}, {do: move, by: {gantry.y: 2}}]"
            )
        )
        await asyncio.sleep(5.0)
        await client.cancel_job(job_id)
        assert (await client.wait_for_job(job_id)).state == "cancelled"
        await fleet.wait_until(lambda states: states["gantry"].mode == "idle")
        shown = await client.retry_job(job_id, 1, dry_run=True)
        here = fleet.controllers["gantry"].position("X") / 1000
        assert 30 < here < 390
        assert [(each.axis, each.position) for each in shown.axes] == [("gantry.x", here), ("gantry.y", 0.0)]
        assert shown.steps == ["2 move to gantry.x=390, speed=10 %", "3 move by gantry.y=2"]
        assert shown.warnings == ["step 3 moves gantry.y by a distance, from the current position"]
        assert len((await client.list_jobs()).jobs) == 2
        fresh = (await client.retry_job(job_id, 1, client_key="k")).job_id
        assert (await client.retry_job(job_id, 1, client_key="k")).job_id == fresh
        report = await client.wait_for_job(fresh)
        assert (report.state, report.origin, report.from_step) == ("done", job_id, 1), report.reason
        assert [step.index for step in report.steps] == [1, 2]
        with pytest.raises(Refusal, match="has the steps 1 to 3"):
            await client.retry_job(job_id, 3)

    run_fleet(main)


def test_after_a_stop_nothing_starts_by_itself() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        running, beside, queued = [await client.submit(each) for each in (GANTRY, STAGE, SHORT)]
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        await client.stop()
        assert [(await client.wait_for_job(each)).state for each in (running, beside)] == ["aborted", "aborted"]
        await asyncio.sleep(2.0)
        later = await client.submit(STAGE)
        await asyncio.sleep(20.0)
        stopped = (await client.list_jobs()).stopped
        assert stopped is not None
        assert (stopped.reason, stopped.actor) == ("stopped by anna", "anna")
        for each in (queued, later):
            assert (await entry(client, each)).reason == "the queue is stopped (stopped by anna): `tutti queue start`"
        await client.start_queue()
        assert [(await client.wait_for_job(each)).state for each in (queued, later)] == ["done", "done"]

    run_fleet(main)


def test_after_an_estop_and_its_reset_nothing_continues_by_itself() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        waits = await client.submit(job("[{do: enable, axes: [gantry]}, {do: dwell, duration: 5 s}, {do: home}]"))
        queued = await client.submit(SHORT)
        await asyncio.sleep(1.0)
        await client.estop("a test")
        await client.reset()
        report = await client.wait_for_job(waits)
        assert (report.state, report.reason) == ("aborted", "e-stop by anna: a test")
        assert len(report.steps) == 2
        assert (await entry(client, queued)).reason.startswith("the queue is stopped (e-stop by anna: a test)")

    run_fleet(main)


def test_jobs_without_axes_are_limited_in_number() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = virtual.make_client()
        dwell = job("[{do: dwell, duration: 2 s}]")
        ids = [await client.submit(dwell) for _ in range(MAX_JOBS_WITHOUT_AXES + 3)]
        await sleep_ns(virtual.clock, NS_PER_S)
        states = [(await entry(client, each)) for each in ids]
        assert [each.state for each in states].count("running") == MAX_JOBS_WITHOUT_AXES
        assert {each.reason for each in states if each.state == "queued"} == {WITHOUT_AXES_REASON}
        with pytest.raises(Refusal, match="jobs without axes") as caught:
            await client.submit(dwell, terms=QueueTerms(now=True))
        assert caught.value.code == "busy"
        # A job with axes is not affected, and the others follow.
        assert (await outcome(virtual, PREPARE)).state == "done"
        assert {(await client.wait_for_job(each)).state for each in ids} == {"done"}

    run_fleet(main)


def test_a_damaged_job_fails_alone_when_a_coordinator_starts() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = virtual.make_client()
        await client.stop_queue()
        dwell = job("[{do: dwell, duration: 10 ms}]")
        ids = [await client.submit(dwell, terms=QueueTerms()) for _ in range(3)]
        follower = await client.submit(dwell, terms=QueueTerms(after=ids[0]))
        db = virtual.journal.database.connection
        db.execute("UPDATE jobs SET body = '{' WHERE id = ?", (ids[0],))
        db.execute("UPDATE jobs SET at_utc = 'soon' WHERE id = ?", (ids[1],))
        virtual.find_process("coordinator/first").kill()
        virtual.start_coordinator("second")
        await sleep_ns(virtual.clock, 5 * NS_PER_S)
        listed = {entry.id: entry for entry in (await client.list_jobs()).jobs}
        assert {each: listed[each].state for each in (*ids, follower)} == {
            ids[0]: "failed",
            ids[1]: "failed",
            ids[2]: "queued",
            follower: "cancelled",
        }
        assert "the Job of job" in listed[ids[0]].reason and "at 'soon'" in listed[ids[1]].reason
        assert sum("job cannot be run" in line for line in virtual.lines) == 2
        await client.start_queue()
        assert (await client.wait_for_job(ids[2])).state == "done"

    run_fleet(main)
