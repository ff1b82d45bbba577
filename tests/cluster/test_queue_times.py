"""Jobs with a time, and the state of the queue after a restart of the coordinator."""

import asyncio
from datetime import timedelta

import pytest
from cluster.worlds import PREPARE, changed, demo_fleet, job, outcome, run_fleet

from orchestrator.client.api import Tutti
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Permit
from orchestrator.model.queue import QueueTerms, format_utc, parse_utc
from orchestrator.model.report import LeaseState, QueueEntry
from orchestrator.runtime.virtual.fleet import VirtualFleet

SHORT = job("[{do: move, by: {gantry.y: 1}}]")
LONG = job("[{do: move, to: {gantry.x: 390}, speed: 0.1}]")


async def entry(client: Tutti, job_id: str) -> QueueEntry:
    found = (await client.show_job(job_id)).entry
    assert found is not None
    return found


def soon(fleet: VirtualFleet, seconds: float) -> str:
    return format_utc(parse_utc(fleet.clock.utc()) + timedelta(seconds=seconds))


async def restart(fleet: VirtualFleet, name: str, away_s: float) -> None:
    """The coordinator dies; another one starts after a while."""
    fleet.kill("coordinator/first")
    await asyncio.sleep(away_s)
    fleet.start_coordinator(name)
    await fleet.wait_until(lambda states: all(state.mode == "idle" for state in states.values()))
    await asyncio.sleep(3.0)


def test_a_job_starts_at_its_time() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        at = soon(fleet, 30)
        local = parse_utc(at).astimezone().isoformat()
        waits = await client.enqueue_job(SHORT, terms=QueueTerms(at=local, priority=9))
        assert (waits.terms.at, waits.reason) == (at, "submitted")
        # It blocks no other job until then.
        assert (await outcome(fleet, SHORT)).state == "done"
        assert (await entry(client, waits.id)).reason == f"begins at {at}"
        report = await client.wait_for_job(waits.id)
        assert report.state == "done"
        assert report.started_utc is not None
        assert timedelta() <= parse_utc(report.started_utc) - parse_utc(at) < timedelta(milliseconds=50)
        assert [each.reason for each in report.transitions[:2]] == ["submitted", f"start time {at} has come"]

    run_fleet(main)


def test_a_time_that_is_past_or_unknown_is_refused() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        with pytest.raises(Refusal, match="is in the past; it is now") as caught:
            await client.submit(SHORT, terms=QueueTerms(at=soon(fleet, -60)))
        assert caught.value.code == "past"
        report = await client.wait_for_job(
            await client.submit(SHORT, terms=QueueTerms(at=soon(fleet, -60), missed="run"))
        )
        assert report.transitions[1].reason.startswith("begins late")
        # A repeated request has its answer, however late it is.
        terms = QueueTerms(at=soon(fleet, 1))
        first = await client.submit(SHORT, "key", terms)
        await asyncio.sleep(60)
        assert await client.submit(SHORT, "key", terms) == first
        for text in ("2026-11-21T22:00:00", "at noon", "0001-01-01T00:00:00+14:00"):
            with pytest.raises(ValueError, match=r"offset|RFC 3339|calendar"):
                QueueTerms(at=text)

    run_fleet(main)


@pytest.mark.parametrize(
    ("away_s", "missed", "state"), [(60, "skip", "cancelled"), (60, "run", "done"), (3, "skip", "done")]
)
def test_a_time_that_comes_while_there_is_no_leader(away_s: float, missed: str, state: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        terms = QueueTerms.model_validate({"at": soon(fleet, 2), "missed": missed})
        waits = await client.submit(SHORT, terms=terms)
        await restart(fleet, "second", away_s)
        report = await client.wait_for_job(waits)
        assert report.state == state, report.reason
        if state == "cancelled":
            assert report.reason == f"missed: no leader was active at {terms.at}"

    run_fleet(main)


def test_the_queue_survives_the_coordinator() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        running = await client.submit(LONG)
        a, b, c = [
            await client.submit(SHORT, terms=terms) for terms in (QueueTerms(), QueueTerms(), QueueTerms(held=True))
        ]
        then = await client.submit(SHORT, terms=QueueTerms(after=running))
        await client.reorder_job(b, before=a)
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        await restart(fleet, "second", 2)
        assert (await client.wait_for_job(running)).state == "interrupted"
        assert (await client.wait_for_job(then)).reason.startswith(
            f"job {running}, which must be done before, is interrupted"
        )
        # A step was interrupted: nothing begins by itself.
        await asyncio.sleep(20)
        assert (await entry(client, b)).reason.startswith("the queue is stopped (a job was interrupted")
        await client.start_queue()
        reports = [await client.wait_for_job(each) for each in (b, a)]
        assert [each.state for each in reports] == ["done", "done"]
        assert (reports[0].started_utc or "") < (reports[1].started_utc or "")
        assert (await entry(client, c)).held_by == "anna"
        # An axis that has moved once does not move again.
        assert [each.state for each in reports[0].transitions].count("committed") == 1

    run_fleet(main)


def test_a_lease_for_maintenance_survives_an_open_door_and_a_restart() -> None:
    closed = Permit(input="gantry.door", value=False)
    guarded = changed(demo_fleet()).model_copy(update={"permits": {"door-closed": closed}})

    async def main(fleet: VirtualFleet) -> None:
        anna, ben = fleet.make_client("anna"), fleet.make_client("ben")
        await outcome(fleet, PREPARE)
        taken, holder = await anna.reserve_axes(["gantry.x"], 3600, "new belt")
        assert taken == ["gantry.x", "gantry.y"]
        waiting = await ben.submit(SHORT)
        # An operator at the machine opens the door, and closes it again.
        for level in (False, True):
            fleet.act_on_controller("gantry", lambda gantry, level=level: gantry.set_input(1, level=level))
            await asyncio.sleep(2.0)
        assert (await entry(ben, waiting)).reason.startswith("waits for gantry: in use by anna (new belt, until ")
        assert not (await ben.status())["gantry"].leases
        await restart(fleet, "second", 2)
        assert (await entry(ben, waiting)).reason.startswith("waits for gantry: in use by anna (new belt, until ")
        assert [(each.controller, each.actor) for each in await ben.list_leases() if each.holder] == [
            ("gantry", "anna")
        ]
        with pytest.raises(Refusal, match="is in use by anna"):
            await ben.reserve_axes(["gantry"], 60)
        with pytest.raises(ValueError, match="pattern"):
            await ben.release_axes(waiting)
        await ben.release_axes(holder)
        assert (await ben.wait_for_job(waiting)).state == "done"
        assert fleet.journal.list_reservations() == []

    run_fleet(main, guarded)


def test_a_lease_with_a_duration_expires_by_itself() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        await anna.reserve_axes(["gantry"], 10)
        heard: list[LeaseState] = []
        await anna.bus.subscribe(
            anna.keys.leases, lambda sample: heard.append(LeaseState.model_validate_json(sample.payload))
        )
        before_ns = fleet.clock.now_ns()
        assert (await outcome(fleet, SHORT)).state == "done"
        assert 9e9 < fleet.clock.now_ns() - before_ns < 13e9
        assert (heard[0].holder, heard[0].what) == (None, "manual work")
        assert fleet.journal.list_reservations() == []

    run_fleet(main)
