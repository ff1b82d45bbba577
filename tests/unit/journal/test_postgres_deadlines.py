"""A server that does not answer: each call ends by its deadline, and what it did is found out or stated as unknown."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from time import monotonic
from typing import Any

import pytest

pytest.importorskip("psycopg")
from unit.journal.servers import PostgresServer
from unit.journal.test_journal import JOB, utc

from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.postgres.address import read_address
from orchestrator.coordinator.journal.postgres.errors import ConnectionLost
from orchestrator.coordinator.journal.postgres.journal import FleetDatabase, PostgresJournal
from orchestrator.coordinator.journal.postgres.lease import LeaseRenewal
from orchestrator.coordinator.journal.postgres.session import Session, Statement
from orchestrator.coordinator.journal.records import JournalError, UnknownResult
from orchestrator.model.report import JobTransition

pytestmark = pytest.mark.postgres
DEADLINE_S = 0.5
CONNECT_S = 2.0  # the least that libpq takes
SLACK_S = 1.5


class Desk:
    """A journal that leads, on a server that all tests share, and that each leaves as it was."""

    def __init__(self, server: PostgresServer, number: int, stack: ExitStack) -> None:
        self.server = server
        self.place = FleetDatabase(read_address(server.make_address("journal")), f"slow{number}", deadline_s=DEADLINE_S)
        self.journal = stack.enter_context(closing(PostgresJournal(self.place)))
        self.journal.take_epoch(0)
        self.stack = stack

    def submit(self, key: str) -> tuple[str, bool]:
        return self.journal.accept_job(key, key, JOB, utc(1))

    def cut(self, monkeypatch: pytest.MonkeyPatch, is_cut: Callable[[str], bool], *, after: bool) -> None:
        """Lose the connection once, before or after the server has done the statements of which one is so."""
        run, cuts = Session._run, [True]

        def cut_and_run(session: Session, connection: Any, statements: list[Statement]) -> Any:
            if (
                not cuts
                or session is not self.journal.database.session
                or not any(is_cut(each.text) for each in statements)
            ):
                return run(session, connection, statements)
            cuts.clear()
            if after:
                run(session, connection, statements)
            connection.pgconn.finish()
            return run(session, connection, statements)

        monkeypatch.setattr(Session, "_run", cut_and_run)


@pytest.fixture
def desk(server: PostgresServer, number: int) -> Iterator[Desk]:
    with ExitStack() as stack:
        yield Desk(server, number, stack)


def test_a_suspended_server_ends_each_call_by_its_deadline(desk: Desk) -> None:
    desk.submit("before")
    lease = desk.stack.enter_context(closing(LeaseRenewal(desk.place)))
    assert lease.renew(1)
    desk.server.suspend()
    try:
        for call in (lambda: desk.submit("a"), lambda: lease.renew(1)):
            began_s = monotonic()
            with pytest.raises(JournalError, match=r"cannot be reached|no answer"):
                call()
            assert monotonic() - began_s < DEADLINE_S + CONNECT_S + SLACK_S
    finally:
        desk.server.resume()
    assert desk.journal.load_record("a") is None
    assert desk.submit("a") == ("a", True) and lease.renew(1)


def test_a_server_that_was_restarted_is_connected_to_again(desk: Desk) -> None:
    desk.submit("a")
    desk.server.stop()
    with pytest.raises(ConnectionLost, match="cannot be reached") as caught:
        desk.submit("b")
    assert "see whether its server runs" in caught.value.remedy and "\n" not in str(caught.value)
    desk.server.start()
    assert desk.submit("b") == ("b", True) and desk.submit("a") == ("a", False)
    desk.server.stop()
    desk.server.start()
    # What begins a transaction is sent again by itself: nothing of it was done.
    assert desk.submit("c") == ("c", True)


@pytest.mark.parametrize("after", [False, True], ids=["not done", "done"])
def test_after_a_commit_without_an_answer_its_result_is_found_out(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, after: bool
) -> None:
    desk.cut(monkeypatch, lambda text: text == "COMMIT", after=after)
    if after:
        assert desk.submit("a") == ("a", True)
    else:
        with pytest.raises(ConnectionLost, match="nothing of it was stored"):
            desk.submit("a")
    assert desk.submit("a") == ("a", not after)
    assert [job.id for job in desk.journal.list_unfinished()] == ["a"]


def test_a_connection_that_is_lost_in_the_middle_stores_nothing(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.submit("a")
    transition = JobTransition(state="running", reason="", actor="a", utc=utc(2))
    desk.cut(monkeypatch, lambda text: text.startswith("INSERT INTO transitions"), after=True)
    with pytest.raises(ConnectionLost), desk.journal.database.transaction():
        desk.journal.record_transition("a", transition)
        desk.journal.list_transitions("a")
    assert len(desk.journal.list_transitions("a")) == 1
    desk.cut(monkeypatch, lambda text: text == "BEGIN", after=True)
    desk.journal.record_transition("a", transition)
    assert len(desk.journal.list_transitions("a")) == 2


def test_a_commit_is_unknown_where_the_server_stays_away(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.cut(monkeypatch, lambda text: text == "COMMIT", after=True)
    run = Session.run

    def stay_away(session: Session, statements: list[Statement]) -> Any:
        if session.connection is None:
            raise ConnectionLost("away")
        return run(session, statements)

    with monkeypatch.context() as patch:
        patch.setattr(Session, "run", stay_away)
        with pytest.raises(UnknownResult, match="no answer whether it was stored"):
            desk.submit("a")
    assert desk.submit("a") == ("a", False)


def test_a_commit_that_another_leader_has_written_over_is_unknown(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.cut(monkeypatch, lambda text: text == "COMMIT", after=True)
    find = desk.journal.database._find_result

    def find_later(**values: bool) -> bool:
        with closing(PostgresJournal(desk.place)) as other:
            other.take_epoch(0)
        return find(**values)

    monkeypatch.setattr(desk.journal.database, "_find_result", find_later)
    with pytest.raises(UnknownResult):
        desk.submit("a")


def test_a_group_whose_commit_is_unknown_is_not_run_again(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.submit("a")
    transition = JobTransition(state="running", reason="", actor="a", utc=utc(2))
    calls = [JournalCall(desk.journal.record_transition, ("a", transition)) for _ in range(2)]

    def lose(**_: bool) -> bool:
        raise UnknownResult("unknown")

    desk.cut(monkeypatch, lambda text: text == "COMMIT", after=True)
    monkeypatch.setattr(desk.journal.database, "_find_result", lose)
    desk.journal.run_group(calls, desk.journal.database.epoch)
    assert all(isinstance(call.error, UnknownResult) and call.is_done for call in calls)
    assert len(desk.journal.list_transitions("a")) == 3


def test_a_lock_of_another_session_ends_by_the_deadline(desk: Desk) -> None:
    other = desk.stack.enter_context(closing(PostgresJournal(desk.place)))
    with other.database.lock_leader():
        other.list_named_points()
        with pytest.raises(ConnectionLost, match=r"no answer within 0\.5 s"):
            desk.submit("a")
    assert desk.submit("a") == ("a", True)
