"""A coordinator whose epoch is over writes nothing, and a take-over waits for no leader that is suspended."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from typing import Any

import pytest

pytest.importorskip("psycopg")
from unit.journal.servers import PostgresServer
from unit.journal.test_journal import JOB, utc

from orchestrator.coordinator.journal.postgres.address import read_address
from orchestrator.coordinator.journal.postgres.errors import ConnectionLost
from orchestrator.coordinator.journal.postgres.journal import FleetDatabase, PostgresJournal
from orchestrator.coordinator.journal.postgres.lease import LeaseRenewal
from orchestrator.coordinator.journal.records import EpochOvertaken, HistoryLost
from orchestrator.model.queue import QueueStop

pytestmark = pytest.mark.postgres


class Contenders:
    """Coordinators of one fleet on the server."""

    def __init__(self, server: PostgresServer, number: int, stack: ExitStack) -> None:
        self.server = server
        self.place = FleetDatabase(read_address(server.make_address("journal")), f"fence{number}")
        self._stack = stack

    def open(self, coordinator: str) -> PostgresJournal:
        place = self.place._replace(coordinator=coordinator)
        return self._stack.enter_context(closing(PostgresJournal(place)))

    def list_names(self) -> list[str]:
        """The names of the sessions of this fleet."""
        query = "SELECT application_name FROM pg_stat_activity WHERE application_name LIKE 'tutti %'"
        return sorted(str(name) for (name,) in self.server.execute(query) if self.place.fleet in str(name).split())

    def lease(self) -> LeaseRenewal:
        return self._stack.enter_context(closing(LeaseRenewal(self.place)))


@pytest.fixture
def contenders(server: PostgresServer, number: int) -> Iterator[Contenders]:
    with ExitStack() as stack:
        yield Contenders(server, number, stack)


WRITES: list[Callable[[PostgresJournal], Any]] = [
    lambda journal: journal.accept_job("late", "late", JOB, utc(1)),
    lambda journal: journal.store_queue_stop(QueueStop(reason="late", actor="a", utc=utc(1))),
    lambda journal: journal.delete_position("late"),
    lambda journal: journal.database.write(
        "INSERT INTO decisions (job_id, step, epoch, t0_fleet_ns, members, utc) VALUES ('a', 1, 1, 1, '', '')"
    ),
    lambda journal: journal.points.delete_upload("late"),
]


@pytest.mark.parametrize("write", WRITES)
def test_what_a_leader_of_before_writes_is_refused(
    contenders: Contenders, write: Callable[[PostgresJournal], Any]
) -> None:
    first, second = contenders.open("first"), contenders.open("second")
    assert first.take_epoch(0) == 1
    write(first)
    before = first.find_jobs(9), first.load_queue_stop(), first.list_decisions("a")
    assert second.take_epoch(0) == 2
    for _ in range(2):  # also on its new connection
        with pytest.raises(EpochOvertaken, match="epoch 1 is over: a coordinator leads with epoch 2"):
            write(first)
    with pytest.raises(EpochOvertaken):
        first.require_latest_epoch(1)
    second.require_latest_epoch(2)
    assert (second.find_jobs(9), second.load_queue_stop(), second.list_decisions("a")) == before
    write(second)


def test_a_journal_that_has_taken_no_epoch_writes_only_before_the_first_leader(contenders: Contenders) -> None:
    standby, leader = contenders.open("standby"), contenders.open("leader")
    standby.accept_job("a", "a", JOB, utc(1))
    leader.take_epoch(0)
    with pytest.raises(EpochOvertaken):
        standby.accept_job("b", "b", JOB, utc(1))
    assert standby.load_job("a") == JOB  # it reads all the same


def test_an_open_transaction_of_the_leader_of_before_delays_no_take_over(contenders: Contenders) -> None:
    first, second = contenders.open("first"), contenders.open("second")
    first.take_epoch(0)
    with pytest.raises(ConnectionLost, match="nothing of it was stored"), first.database.transaction():
        first.list_named_points()
        first.delete_position("x")
        assert second.take_epoch(0) == 2  # within the deadline of a statement
        first.list_named_points()
    with pytest.raises(EpochOvertaken):
        first.delete_position("x")
    assert second.accept_job("a", "a", JOB, utc(1)) == ("a", True)


def test_names_of_sessions_state_the_epoch_and_ends_only_those_of_leaders(contenders: Contenders) -> None:
    leader, standby = contenders.open("leader"), contenders.open("standby")
    leader.take_epoch(0)

    fleet = contenders.place.fleet
    assert contenders.list_names() == [f"tutti {fleet} 1", f"tutti {fleet} standby"]
    contenders.open("third").take_epoch(0)
    assert contenders.list_names() == [f"tutti {fleet} 2", f"tutti {fleet} standby"]
    assert standby.load_record("x") is None


def test_a_database_that_is_older_than_the_adapters_does_not_lead(contenders: Contenders) -> None:
    journal = contenders.open("a")
    with pytest.raises(HistoryLost, match="its epoch is 0, and a controller has seen 7") as caught:
        journal.take_epoch(7)
    assert "tutti journal import" in caught.value.remedy
    journal.set_epoch(7)
    assert journal.take_epoch(7) == 8
    assert journal.take_epoch(2**50) == 9  # which is no real one
    contenders.server.execute(f"UPDATE tutti_{contenders.place.fleet}.leader SET epoch = 3", "journal")
    with pytest.raises(HistoryLost, match="its epoch is 3, and 9 was taken from it"):
        journal.delete_position("x")


def test_two_fleets_in_one_database_do_not_see_each_other(contenders: Contenders, number: int) -> None:
    lab = contenders.open("a")
    other = contenders.place._replace(fleet="l" * 60 + str(number))
    longer = contenders.place._replace(fleet="l" * 60 + f"{number}x")
    with closing(PostgresJournal(other)) as hall, closing(PostgresJournal(longer)) as third:
        assert [each.take_epoch(0) for each in (lab, hall, hall, third)] == [1, 1, 2, 1]
        hall.accept_job("a", "a", JOB, utc(1))
        assert lab.load_record("a") is None and third.load_record("a") is None
        lab.require_latest_epoch(1)


def test_the_lease_is_renewed_while_a_write_is_open_and_not_after_a_take_over(contenders: Contenders) -> None:
    leader, lease, reader = contenders.open("leader"), contenders.lease(), contenders.lease()
    epoch = leader.take_epoch(0)
    first = reader.read_state()
    assert (first.epoch, first.coordinator, first.renewals) == (1, "leader", 0)
    with leader.database.transaction():
        leader.delete_position("x")
        leader.list_named_points()
        assert lease.read_state().renewals == 0  # as a standby does
        assert lease.renew(epoch)
        assert reader.read_state().renewals == 1
        assert contenders.list_names().count(f"tutti {contenders.place.fleet} 1") == 2
    contenders.open("second").take_epoch(0)
    assert not lease.renew(epoch)
    assert reader.read_state()[:3] == (2, "second", 1)
