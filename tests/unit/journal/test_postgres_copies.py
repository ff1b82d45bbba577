"""Two copies: what a primary and its standby promise, what is refused without the standby, and what goes on."""

import signal
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from statistics import median
from time import perf_counter

import pytest

pytest.importorskip("psycopg")
from unit.journal.conftest import require_server
from unit.journal.servers import PostgresServer, find_programs
from unit.journal.test_journal import JOB, end, utc

from orchestrator.coordinator.journal.postgres.address import read_address
from orchestrator.coordinator.journal.postgres.errors import AnswerLate, ConnectionLost
from orchestrator.coordinator.journal.postgres.journal import FleetDatabase, PostgresJournal
from orchestrator.coordinator.journal.postgres.lease import LeaseRenewal
from orchestrator.coordinator.journal.postgres.opening import find_database, open_journal
from orchestrator.coordinator.journal.records import CopyMissing, HistoryLost, JournalError, UnknownResult
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.model.report import JobTransition

pytestmark = pytest.mark.postgres
STEPS, LOOK_S = 400, 0.02  # of waiting for the servers


class Pair:
    """A primary with a synchronous standby."""

    def __init__(self, primary: PostgresServer, standby: PostgresServer) -> None:
        self.primary = primary
        self.standby = standby

    @property
    def address(self) -> str:
        return f"postgresql://tutti@127.0.0.1:{self.primary.port},127.0.0.1:{self.standby.port}/journal"

    def wait_for_health(self, journal: PostgresJournal, mode: str) -> None:
        for _ in range(STEPS):
            if journal.read_health().mode == mode:
                return
            signal.sigtimedwait([], LOOK_S)
        raise AssertionError(journal.read_health())

    def wait_until_caught_up(self) -> None:
        """Wait until the standby has all that the primary has."""
        caught_up = "SELECT flush_lsn >= pg_current_wal_flush_lsn() FROM pg_stat_replication"
        for _ in range(STEPS):
            if self.primary.execute(caught_up) == [(True,)]:
                return
            signal.sigtimedwait([], LOOK_S)
        raise AssertionError(self.primary.execute("SELECT * FROM pg_stat_replication"))


@contextmanager
def run_pair(base: str = "") -> Iterator[Pair]:
    require_server()
    primary = PostgresServer(find_programs(), base)
    standby: PostgresServer | None = None
    try:
        primary.create()
        primary.execute("CREATE DATABASE journal")
        primary.execute("ALTER SYSTEM SET synchronous_standby_names = 'ANY 1 (second)'")
        standby = primary.make_standby("second")
        primary.execute("SELECT pg_reload_conf()")
        pair = Pair(primary, standby)
        with closing(PostgresJournal(FleetDatabase(read_address(pair.address), "watch", copies=2))) as journal:
            pair.wait_for_health(journal, "two copies")
        yield pair
    finally:
        primary.remove()
        if standby is not None:
            standby.remove()


@pytest.fixture(scope="module")
def pair() -> Iterator[Pair]:
    with run_pair() as pair:
        yield pair


def change(state: str) -> JobTransition:
    return JobTransition.model_validate({"state": state, "reason": "", "actor": "a", "utc": utc(2)})


def test_without_the_standby_promises_are_refused_and_the_job_that_runs_goes_on(pair: Pair, number: int) -> None:
    place = FleetDatabase(read_address(pair.address), f"pair{number}", copies=2, deadline_s=0.5)
    with closing(PostgresJournal(place)) as journal, closing(PostgresJournal(place)) as second:
        lease = LeaseRenewal(place, lambda: journal.database.is_copy_missing)
        epoch = journal.take_epoch(0)
        journal.accept_job("a", "a", JOB, utc(1))
        assert lease.renew(epoch)
        health = journal.read_health()
        assert (health.mode, health.standbys, health.problems) == ("two copies", ("second",), ())
        assert not health.may_lose_jobs
        pair.standby.suspend()
        try:
            # Its result is found out: it is on this machine.
            journal.record_transition("a", change("running"))
            assert journal.database.is_copy_missing
            with pytest.raises(CopyMissing, match="no job is accepted"):
                journal.accept_job("b", "b", JOB, utc(1))
            with pytest.raises(CopyMissing):
                journal.find_keyed_job("", "a")
            journal.record_transition("a", change("paused"))
            assert lease.renew(epoch)
            end(journal, "a")
            assert journal.load_record("b") is None
            health = journal.read_health()
            assert health.mode == "waits for a copy" and "follows: commits wait for it" in health.problems[0].text
            with pytest.raises(CopyMissing):
                second.take_epoch(0)
        finally:
            pair.standby.resume()
        pair.wait_for_health(journal, "two copies")
        assert journal.accept_job("b", "b", JOB, utc(1)) == ("b", True)
        lease.close()


def test_a_leader_at_rest_renews_its_lease_without_its_standby(pair: Pair, number: int) -> None:
    """Nothing is written, so that the journal does not know that its copy is missing: the renewal finds it out, with
    time left for the next one."""
    place = FleetDatabase(read_address(pair.address), f"pair{number}", copies=2, deadline_s=0.5)
    with closing(PostgresJournal(place)) as journal, closing(LeaseRenewal(place)) as lease:
        epoch = journal.take_epoch(0)
        assert lease.renew(epoch)
        pair.standby.suspend()
        try:
            with pytest.raises(AnswerLate):
                lease.renew(epoch)
            assert not journal.database.is_copy_missing
            began_s = perf_counter()
            assert lease.renew(epoch) and lease.renew(epoch)
            assert perf_counter() - began_s < place.deadline_s
        finally:
            pair.standby.resume()
        pair.wait_until_caught_up()
        assert lease.renew(epoch)
        # It waits for the copy again.
        pair.standby.suspend()
        try:
            with pytest.raises(AnswerLate):
                lease.renew(epoch)
        finally:
            pair.standby.resume()


def test_a_promise_that_waits_for_the_standby_is_unknown_and_is_answered_once_it_is_copied(
    pair: Pair, number: int
) -> None:
    place = FleetDatabase(read_address(pair.address), f"pair{number}", copies=2, deadline_s=0.5)
    with closing(PostgresJournal(place)) as journal:
        journal.take_epoch(0)
        pair.standby.suspend()
        try:
            with pytest.raises(UnknownResult, match="no answer whether it was stored"):
                journal.accept_job("a", "a", JOB, utc(1))
            # It can be seen, and is no promise yet.
            assert journal.load_record("a") is not None
            with pytest.raises(CopyMissing):
                journal.accept_job("x", "a", JOB, utc(1))
        finally:
            pair.standby.resume()
        pair.wait_for_health(journal, "two copies")
        assert journal.accept_job("x", "a", JOB, utc(1)) == ("a", False)
        keyed = journal.find_keyed_job("", "a")
        assert keyed is not None and keyed.job_id == "a"


def test_a_server_whose_commits_wait_for_no_copy_promises_nothing(server: PostgresServer, number: int) -> None:
    place = FleetDatabase(read_address(server.make_address("journal")), f"alone{number}", copies=2)
    with closing(PostgresJournal(place)) as journal:
        with pytest.raises(CopyMissing, match="copy of the journal on a second machine is missing"):
            journal.take_epoch(0)
        with pytest.raises(CopyMissing):
            journal.accept_job("a", "a", JOB, utc(1))
        health = journal.read_health()
        assert health.mode == "waits for a copy" and "synchronous_standby_names is empty" in health.problems[0].text
    with closing(PostgresJournal(place._replace(copies=1))) as journal:
        assert journal.take_epoch(0) == 1
        health = journal.read_health()
        assert health.mode == "one copy" and not health.may_lose_jobs


def test_with_one_copy_a_standby_may_lack_jobs(pair: Pair, number: int) -> None:
    """Also one that the server's own sessions wait for: those of the journal do not."""
    place = FleetDatabase(read_address(pair.address), f"pair{number}")
    with closing(PostgresJournal(place)) as journal:
        health = journal.read_health()
        assert (health.mode, health.may_lose_jobs, health.problems) == ("one copy", True, ())


def test_a_standby_alone_takes_no_writes_and_a_user_that_may_not_see_it_has_no_copy(pair: Pair, number: int) -> None:
    with pytest.raises(JournalError, match="it takes no writes") as caught:
        open_journal(pair.standby.make_address("journal"), f"pair{number}")
    assert "promote this one" in caught.value.remedy
    pair.primary.execute("CREATE ROLE plain LOGIN; GRANT CREATE ON DATABASE journal TO plain")
    address = read_address(pair.primary.make_address("journal", "plain"))
    with closing(PostgresJournal(FleetDatabase(address, f"pair{number}", copies=2))) as journal:
        health = journal.read_health()
        assert health.mode == "waits for a copy" and health.problems[0].remedy == "`GRANT pg_monitor TO USER` there"
        with pytest.raises(CopyMissing):
            journal.take_epoch(0)
        pair.primary.execute("GRANT pg_monitor TO plain")
        assert journal.take_epoch(0) == 1


def test_the_promoted_standby_has_what_was_accepted_and_names_what_it_waits_for(number: int) -> None:
    with run_pair() as pair:
        place = FleetDatabase(read_address(pair.address), f"pair{number}", copies=2)
        with closing(PostgresJournal(place)) as journal:
            epoch = journal.take_epoch(0)
            before = journal.read_health()
            accepted = [journal.accept_job(f"j{count}", f"k{count}", JOB, utc(1))[0] for count in range(20)]
            pair.primary.kill()
            pair.standby.promote()
            journal.require_latest_epoch(epoch)  # it has found the other server by itself
            assert [job.id for job in journal.list_unfinished()] == accepted
            health = journal.read_health()
            assert (health.mode, health.timeline, health.system) == (
                "waits for a copy",
                before.timeline + 1,
                before.system,
            )
            assert "`ALTER SYSTEM RESET synchronous_standby_names`" in health.problems[0].remedy
            with pytest.raises(CopyMissing):
                journal.accept_job("late", "late", JOB, utc(1))
            journal.record_transition("j0", change("running"))
        with closing(PostgresJournal(place._replace(copies=1))) as other:
            assert other.take_epoch(epoch) == epoch + 1
            assert other.accept_job("k", "k0", JOB, utc(1)) == ("j0", False)


def test_of_two_primaries_no_coordinator_leads_on_the_older_line(number: int) -> None:
    """The standby is promoted while the primary goes on: a split of the site's own making."""
    with run_pair() as pair:
        fleet = f"split{number}"
        older_first = find_database(pair.address, fleet)
        hosts = (f"127.0.0.1:{server.port}" for server in (pair.standby, pair.primary))
        newer_first = find_database(f"postgresql://tutti@{','.join(hosts)}/journal", fleet)
        with closing(PostgresJournal(older_first._replace(copies=2))) as journal:
            epoch = journal.take_epoch(0)
        pair.standby.promote()
        pair.standby.execute("ALTER SYSTEM RESET synchronous_standby_names")
        pair.standby.execute("SELECT pg_reload_conf()")
        with closing(PostgresJournal(older_first)) as older, pytest.raises(HistoryLost) as refused:
            older.take_epoch(epoch)
        assert f"127.0.0.1:{pair.primary.port} is a primary of timeline 1" in str(refused.value)
        assert "it is the older line" in str(refused.value) and "pg_rewind" in refused.value.remedy
        with closing(PostgresJournal(newer_first)) as newer:
            assert newer.take_epoch(epoch) == epoch + 1
            newer.accept_job("j", "k", JOB, utc(1))
            # Its server is gone for a moment: the other one, which takes writes as well, is not used.
            pair.standby.stop()
            with pytest.raises(HistoryLost):
                for _ in range(2):  # the first call ends with the connection
                    with suppress(ConnectionLost):
                        newer.list_unfinished()
            pair.standby.start()
            assert [job.id for job in newer.list_unfinished()] == ["j"]


def test_a_server_that_is_no_copy_is_refused(server: PostgresServer, pair: Pair, number: int) -> None:
    hosts = (f"127.0.0.1:{port}" for port in (pair.primary.port, server.port))
    place = find_database(f"postgresql://tutti@{','.join(hosts)}/journal", f"other{number}")
    with closing(PostgresJournal(place)) as journal, pytest.raises(HistoryLost, match="another system"):
        journal.take_epoch(0)


def test_a_job_is_accepted_nearly_as_quickly_as_in_a_file(tmp_path: Path) -> None:
    """Nightly: medians of 200 on one disk, alternately, so that what else runs delays each alike."""
    with ExitStack() as stack:
        pair = stack.enter_context(run_pair("/tmp"))
        place = FleetDatabase(read_address(pair.address), "cost")
        file = stack.enter_context(closing(SqliteJournal(tmp_path / "journal.db")))
        one = stack.enter_context(closing(PostgresJournal(place)))
        two = stack.enter_context(closing(PostgresJournal(place._replace(fleet="costs", copies=2))))
        took_s: dict[int, list[float]] = {0: [], 1: [], 2: []}
        for journal in (one, two):
            journal.take_epoch(0)
        for count in range(250):
            for copies, journal in enumerate((file, one, two)):
                began_s = perf_counter()
                journal.accept_job(f"j{count}", f"k{count}", JOB, utc(1))
                took_s[copies].append(perf_counter() - began_s)
        medians = [median(took_s[copies][50:]) for copies in range(3)]
    assert medians[1] <= 1.5 * medians[0] and medians[2] <= 3 * medians[0], medians
