"""A journal in databases on three machines: one fault at each commit of the life of some jobs; and two of them."""

from collections.abc import Callable
from contextvars import Context
from typing import Any, Literal

import pytest

pytest.importorskip("psycopg")
from cluster.databases import (
    LEASE_NS,
    LONG,
    MORE_NS,
    SHORT,
    WITHDRAWAL,
    count_motions,
    promote_later,
    run_site,
    strike_life,
    wait_for_leader,
)
from cluster.worlds import job

from orchestrator.campaign.journal_checks import JournalChecker
from orchestrator.campaign.recording.recorder import BusRecorder
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.coordinator.journal.postgres.database import PostgresDatabase
from orchestrator.coordinator.journal.postgres.transaction import Fence
from orchestrator.model.errors import Refusal
from orchestrator.model.queue import JournalPolicy
from orchestrator.runtime.virtual.databases.site import CommitMoment, DatabaseSite
from orchestrator.runtime.virtual.fleet import VirtualFleet

SLOW = job("[{do: move, by: {gantry.x: 300 mm}, speed: 0.1}]")
COMMITS = 24
"""Those of a life that every life has."""
MOMENTS: tuple[CommitMoment, ...] = ("before", "during", "after")
KINDS = {"accept_job", "record_transition", "record_decision", "record_end", "hold_jobs", "reorder_jobs"}
Strike = Callable[[VirtualFleet, DatabaseSite], None]
PROMOTIONS_NS = (NS_PER_S // 2, NS_PER_S, 4 * NS_PER_S)  # within two thirds of the lease, and beyond


def kill_coordinator(fleet: VirtualFleet, _: DatabaseSite) -> None:
    fleet.kill("coordinator/first")


def kill_primary(fleet: VirtualFleet, site: DatabaseSite, after_ns: int = NS_PER_S) -> None:
    site.kill("db-a")
    promote_later(fleet, site, after_ns)


def kill_leader_machine(fleet: VirtualFleet, site: DatabaseSite) -> None:
    kill_coordinator(fleet, site)
    kill_primary(fleet, site)


def kill_standby(_: VirtualFleet, site: DatabaseSite) -> None:
    site.kill("db-b")


def cut_copies(_: VirtualFleet, site: DatabaseSite) -> None:
    site.cut("db-a", "db-b")


def cut_leader_off(_: VirtualFleet, site: DatabaseSite) -> None:
    site.cut("first", "db-a")


def cut_standby_off(_: VirtualFleet, site: DatabaseSite) -> None:
    site.cut("second", "db-a")


STRIKES: tuple[Strike, ...] = (
    *(kill_coordinator, kill_leader_machine, kill_primary, kill_standby),
    *(cut_copies, cut_leader_off, cut_standby_off),
)


OTHER_CUTS = (
    *(("db-a", "db-c"), ("db-b", "db-c"), ("first", "db-b")),
    *(("first", "db-c"), ("second", "db-b"), ("second", "db-c")),
)
"""The networks between two computers that no strike cuts."""


def name_strike(strike: Strike) -> str:
    return strike.__name__


def test_a_life_stores_every_kind_of_fact() -> None:
    struck = strike_life(-1, "after", kill_standby)
    facts = {fact for commit in struck.facts for fact in commit}
    assert facts >= KINDS | {"store_queue_stop", "store_command", "store_recording"}
    assert len(struck.facts) > COMMITS and not struck.at_ns


@pytest.mark.parametrize(
    ("number", "moment", "strike"),
    [
        (2, "during", kill_leader_machine),  # of an acceptance
        (14, "before", kill_leader_machine),  # of a decision
        (16, "during", kill_leader_machine),
        (2, "during", kill_primary),  # accepted without an answer: it comes into the queue with the next request
        (2, "after", kill_primary),
        (16, "before", kill_primary),  # a step behind the present one is prepared
        (23, "during", cut_leader_off),  # of an end
        (14, "during", kill_standby),
    ],
)
def test_one_fault_loses_nothing_doubles_nothing_and_moves_nothing(
    number: int, moment: CommitMoment, strike: Strike
) -> None:
    struck = strike_life(number, moment, strike)
    assert struck.at_ns
    assert struck.led_ns < LEASE_NS + NS_PER_S + MORE_NS


@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("strike", [kill_leader_machine, kill_primary], ids=name_strike)
def test_one_fault_at_the_withdrawal_of_a_decision_starts_nothing_twice(strike: Strike, moment: CommitMoment) -> None:
    struck = strike_life(WITHDRAWAL, moment, strike)
    assert struck.at_ns and struck.led_ns < LEASE_NS + NS_PER_S + MORE_NS


@pytest.mark.nightly
@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("strike", STRIKES, ids=name_strike)
def test_one_fault_at_every_commit_loses_nothing(strike: Strike, moment: CommitMoment) -> None:
    for number in range(COMMITS):
        struck = strike_life(number, moment, strike)
        assert struck.at_ns, number
        assert struck.led_ns < LEASE_NS + NS_PER_S + MORE_NS, number


@pytest.mark.nightly
@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("computers", OTHER_CUTS, ids="-".join)
def test_a_cut_between_any_two_computers_loses_nothing(computers: tuple[str, str], moment: CommitMoment) -> None:
    for number in range(COMMITS):
        assert strike_life(number, moment, lambda _, site: site.cut(*computers)).at_ns, number


@pytest.mark.nightly
@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("strike", [kill_leader_machine, kill_primary, kill_standby], ids=name_strike)
def test_one_fault_of_a_slow_database_loses_nothing(strike: Strike, moment: CommitMoment) -> None:
    for number in range(COMMITS):
        assert strike_life(number, moment, strike, 300 * NS_PER_MS).at_ns, number


@pytest.mark.nightly
@pytest.mark.parametrize("after_ns", PROMOTIONS_NS)
def test_a_primary_whose_standby_is_promoted_later_loses_nothing(after_ns: int) -> None:
    def strike(fleet: VirtualFleet, site: DatabaseSite) -> None:
        kill_primary(fleet, site, after_ns)

    for number in range(COMMITS):
        for moment in MOMENTS:
            assert strike_life(number, moment, strike).at_ns


@pytest.mark.parametrize(("copies", "note"), [(1, "after a fail-over accepted jobs may be missing"), (2, "")])
def test_the_answer_to_a_submission_says_what_the_journal_does_not_promise(copies: Literal[1, 2], note: str) -> None:
    async def main(fleet: VirtualFleet, _: DatabaseSite) -> None:
        client = fleet.make_client()
        entry = await client.enqueue_job(SHORT, "key")
        again = await client.enqueue_job(SHORT, "key")
        assert note in entry.note and bool(note) == bool(entry.note) and again.note == entry.note
        assert (await client.list_jobs(limit=1)).jobs[0].note == ""

    run_site(main, policy=JournalPolicy(copies=copies))


def test_a_leader_ends_once_with_a_slow_database_and_says_so() -> None:
    async def main(fleet: VirtualFleet, site: DatabaseSite) -> None:
        site.commit_ns = 2 * NS_PER_S
        await sleep_ns(fleet.clock, 20 * NS_PER_S)
        assert not fleet.coordinators["first"][0].alive
        assert sum('"epoch": 1' in line and "could not be renewed for 2.0 s" in line for line in fleet.lines) == 1
        site.commit_ns = 0
        begun_ns = fleet.clock.now_ns()
        assert await wait_for_leader(fleet, "second") - begun_ns < 2 * LEASE_NS + MORE_NS

    run_site(main)


@pytest.mark.parametrize("after_ns", range(0, NS_PER_S, NS_PER_S // 4))
def test_a_leader_at_rest_goes_on_without_its_standby(after_ns: int) -> None:
    async def main(fleet: VirtualFleet, site: DatabaseSite) -> None:
        await sleep_ns(fleet.clock, 60 * NS_PER_S + after_ns)  # nothing is written any more
        site.kill("db-b")
        await sleep_ns(fleet.clock, 30 * NS_PER_S)
        assert fleet.coordinators["first"][0].alive

    run_site(main, ("db-a", "db-b"))


def test_what_is_lost_with_two_machines_was_declared() -> None:
    async def main(fleet: VirtualFleet, site: DatabaseSite) -> None:
        client = fleet.make_client()
        submitted = await client.submit(SLOW)
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        before = count_motions(fleet)
        site.kill("db-b")
        await sleep_ns(fleet.clock, 12 * NS_PER_S)  # each ten seconds it is looked at
        assert any("journal-copies" in line for line in fleet.lines)
        with pytest.raises(Refusal, match="copy"):
            await client.submit(SHORT)
        # The one that runs goes on to its end; the standby does not know that.
        assert (await client.wait_for_job(submitted)).state == "done"
        site.kill("db-a")
        fleet.kill("coordinator/first")
        site.revive("db-b")
        site.promote("db-b")
        site.revive("db-a")
        await wait_for_leader(fleet, "second")
        await sleep_ns(fleet.clock, NS_PER_S)  # it ends what was left running
        row = fleet.journal.load_record(submitted.id)
        assert row is not None and row.state == "interrupted"
        moved = count_motions(fleet)
        await sleep_ns(fleet.clock, NS_PER_S)
        await client.start_queue()
        await sleep_ns(fleet.clock, 10 * NS_PER_S)
        assert count_motions(fleet) == moved and moved["gantry"] == before["gantry"] + 1

    run_site(main, ("db-a", "db-b"))


def test_a_dead_machine_that_answers_nothing_keeps_no_standby_from_leading() -> None:
    async def main(fleet: VirtualFleet, site: DatabaseSite) -> None:
        site.is_silent = True
        kill_leader_machine(fleet, site)
        begun_ns = fleet.clock.now_ns()
        # Connections with it are given up after two seconds each.
        assert await wait_for_leader(fleet, "second") - begun_ns < LEASE_NS + NS_PER_S + MORE_NS + 4 * NS_PER_S

    run_site(main)


def find_deposed_writes(after_ns: int) -> list[str]:
    """What a leader writes that was suspended on the way to its journal, and resumes behind the take-over of the
    standby. after_ns: from the request for a job."""
    found: list[str] = []

    async def main(fleet: VirtualFleet, site: DatabaseSite) -> None:
        recorder = BusRecorder(fleet.clock, lambda _: None)
        JournalChecker(fleet, recorder, lambda invariant, text: found.append(f"{invariant}: {text}"))
        site.call_ns = 100 * NS_PER_MS
        Context().run(fleet.clock.loop.create_task, fleet.make_client().submit(LONG))
        await sleep_ns(fleet.clock, after_ns)
        fleet.freeze("coordinator/first")
        await wait_for_leader(fleet, "second")
        fleet.resume("coordinator/first")
        await sleep_ns(fleet.clock, 5 * NS_PER_S)
        assert not fleet.coordinators["first"][0].alive

    run_site(main)
    return found


def require_nothing(_: PostgresDatabase, __: list[Any], ___: int) -> None:
    return None


def hold_any_epoch(_: int) -> Fence:
    return Fence.lock()


@pytest.mark.parametrize("after_ms", [190, 490, 690])  # on the way to the acceptance, to the begin, to the decision
def test_a_write_without_its_epoch_is_found(monkeypatch: pytest.MonkeyPatch, after_ms: int) -> None:
    after_ns = after_ms * NS_PER_MS
    assert find_deposed_writes(after_ns) == []
    # Both what is asked with each read, and what each write holds.
    monkeypatch.setattr(PostgresDatabase, "_require_last", require_nothing)
    assert find_deposed_writes(after_ns) == []
    monkeypatch.setattr(Fence, "hold", hold_any_epoch)
    assert [text for text in find_deposed_writes(after_ns) if text.startswith("24: the leader of epoch 1 wrote")]
