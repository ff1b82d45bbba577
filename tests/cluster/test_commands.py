"""Commands of users in the journal: what changes something is there once, by the user and the address that gave it."""

# pyright: reportPrivateUsage=false

import asyncio
import json
from contextlib import suppress

import pytest
from cluster.worlds import PREPARE, job, outcome, run_fleet

from orchestrator.bus.base import RequestRefused
from orchestrator.bus.service_verbs import SERVICE_VERBS
from orchestrator.coordinator.journal.sql import command_table
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import SubmitJob
from orchestrator.model.operation.commands import CommandRecord
from orchestrator.model.queue import QueueTerms
from orchestrator.runtime.virtual.fleet import VirtualFleet

DWELL = job("[{do: dwell, duration: 1 s}]")


async def commands(fleet: VirtualFleet, actor: str) -> list[tuple[str, str, str]]:
    """Verb, subject and refusal of the commands of a user, the oldest first."""
    found = await fleet.make_client("looker").list_commands(1000, by=actor)
    assert all(each.actor == actor for each in found)
    return [(each.verb, each.subject, each.refused) for each in reversed(found)]


def test_commands_are_recorded_with_what_they_are_about() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna@10.0.0.7")
        await outcome(fleet, PREPARE)
        job_id = await anna.submit(DWELL, terms=QueueTerms(held=True))
        await anna.hold_jobs(job_id)
        await anna.release_jobs()
        await anna.wait_for_job(job_id)
        await anna.retry_job(job_id, dry_run=True)
        again = (await anna.retry_job(job_id)).job_id
        for refused in (anna.cancel_job("none"), anna.save_position("gantry", "gantry.x")):
            with pytest.raises(Refusal):
                await refused
        await anna.save_position("here", at={"gantry.x": 1})
        async with anna.manual_control(["gantry.x"], what="alignment"):
            await asyncio.sleep(10.0)  # it is renewed all the time
        await anna.stop_queue()
        await anna.stop()
        await anna.start_queue()
        await anna.list_jobs()
        await asyncio.sleep(0.1)
        assert await commands(fleet, "anna@10.0.0.7") == [
            ("submit", f"{job_id} 'test'", ""),
            ("hold", job_id, ""),
            ("release", "all held jobs", ""),
            ("retry", f"{again} {job_id} from step 1", ""),
            ("cancel", "none", "unknown-job"),
            ("save-position", "gantry", "bad-name"),
            ("save-position", "here", ""),
            ("acquire-axes", "gantry.x: alignment", ""),
            ("release-axes", "gantry.x gantry.y", ""),
            ("stop-queue", "", ""),
            ("stop", "decelerate", ""),
            ("start-queue", "", ""),
        ]

    run_fleet(main)


def test_a_repeated_request_is_one_command_and_what_only_reads_is_none() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        request = SubmitJob(**client.request_fields(), job=DWELL, client_key="k")
        for _ in range(3):
            await client.bus.request(f"{client.keys.prefix}/svc/submit", request.to_json(), 5.0)
        assert len(await commands(fleet, "anna")) == 1
        # Every verb that changes something is recorded, also when it is refused.
        for name in SERVICE_VERBS:
            head = {"request_id": f"r-{name}", "actor": f"by {name}"}
            with suppress(RequestRefused):  # it needs more fields
                await client.bus.request(f"{client.keys.prefix}/svc/{name}", json.dumps(head).encode(), 5.0)
        await asyncio.sleep(0.1)
        recorded = {each.verb for each in await client.list_commands(1000) if each.actor == f"by {each.verb}"}
        assert {"start-queue", "stop-queue", "stop", "release", "check-wiring", "acknowledge"} <= recorded
        assert not [name for name in recorded if SERVICE_VERBS[name].reads]

    run_fleet(main)


def test_a_journal_that_cannot_be_written_turns_no_command_into_an_error() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        running = await anna.submit(job("[{do: move, to: {gantry.x: 300}, speed: 0.1}]"))
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        fleet.coordinator_disk.full = True
        await anna.pause_job(running)
        await anna.stop()
        await asyncio.sleep(1.0)
        assert [line for line in fleet.lines if "pause by anna is not in the journal" in line]
        assert [line for line in fleet.lines if "stop by anna is not in the journal" in line]
        fleet.coordinator_disk.full = False
        assert (await anna.wait_for_job(running)).state == "aborted"
        assert [verb for verb, _, _ in await commands(fleet, "anna")] == ["submit"]

    run_fleet(main)


def test_commands_are_found_page_by_page_and_by_user() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna, ben = fleet.make_client("anna@10.0.0.7"), fleet.make_client("ben@10.0.0.8")
        for number in range(5):
            await (anna if number % 2 else ben).start_queue()
            await asyncio.sleep(1.0)
        newest = await anna.list_commands(3)
        rest = await anna.list_commands(1000, before=newest[-1].utc)
        assert [each.actor for each in (*newest, *rest)] == [each.actor for each in (ben, anna, ben, anna, ben)]
        assert len(await anna.list_commands(by="10.0.0.8")) == 3 and await anna.list_commands(by="carl") == []

    run_fleet(main)


def test_of_the_commands_the_newest_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command_table, "MAX_COMMANDS", 3)
    journal = SqliteJournal(":memory:")
    for number in range(5):
        utc = f"2026-01-01T00:00:0{number}.000000Z"
        journal.commands.store_command(CommandRecord(utc=utc, actor="a", verb="stop", subject=str(number), refused=""))
    assert [each.subject for each in journal.commands.list_commands(10)] == ["4", "3", "2"]
    assert journal.database.select("SELECT count(*) FROM commands") == [(3,)]


def test_a_long_subject_is_cut() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        with pytest.raises(Refusal):
            await anna.hold_jobs(*(f"job{number}" for number in range(1000)))
        ((_, subject, refused),) = await commands(fleet, "anna")
        assert len(subject) == 200 and subject.endswith("…") and refused == "unknown-job"

    run_fleet(main)
