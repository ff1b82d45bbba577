"""Two coordinators on one journal in PostgreSQL, as on two computers: the leader is lost, hands over, or cannot reach its
database."""

from collections.abc import Iterator

import pytest
from children import wait_until
from fleet import SLOW_AXES, Steps, margin_s
from shared_fleet import NAMES, SharedFleet

pytest.importorskip("psycopg")
from unit.journal.conftest import server
from unit.journal.servers import PostgresServer

from orchestrator.clock.live import raw_ns
from orchestrator.model.queue import JournalPolicy

__all__ = ["server"]

pytestmark = [pytest.mark.live, pytest.mark.alone, pytest.mark.postgres]

TAKE_OVER_S = 5.0
LEASE_S = 3.0
SUSPENDED_S = 12.0  # of the database
BUSY_S = 4.0  # margin for a busy machine, including an interpreter's start
BACK: Steps = [{"do": "move", "to": {"gantry.x": 5, "stage.u": 2}}]


@pytest.fixture(scope="module")
def running(server: PostgresServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedFleet]:
    fleet = SharedFleet(tmp_path_factory.mktemp("shared"), server.make_address("journal"), JournalPolicy())
    try:
        fleet.start()
        yield fleet
    finally:
        fleet.close()


@pytest.fixture
def fleet(running: SharedFleet) -> SharedFleet:
    """The fleet of all tests here, at rest, with its queue started and a standby."""
    running.bring_back()
    wait_until(running.has_standby, "a coordinator stands by")
    return running


def lose_leader(fleet: SharedFleet) -> None:
    """Kill the leader's processes; the other coordinator leads in time."""
    first, epoch = fleet.find_leader(), fleet.epoch()
    lost_ns = raw_ns()
    fleet.parts[first].kill()
    wait_until(lambda: fleet.epoch() > epoch, "the other one leads")
    assert margin_s(lost_ns, raw_ns()) < TAKE_OVER_S + BUSY_S
    assert fleet.find_leader() != first
    fleet.start_coordinator(first)


def is_referenced(fleet: SharedFleet) -> bool:
    states = fleet.status()
    return states["gantry"].axes["x"].referenced and states["stage"].axes["u"].referenced


def test_a_motion_is_interrupted_when_its_leader_dies(fleet: SharedFleet) -> None:
    running = fleet.slow_move()
    queued = fleet.submit(BACK)
    lose_leader(fleet)
    report = fleet.wait(running)
    assert report.state == "interrupted", report.reason
    assert "the queue is stopped" in fleet.tutti("queue", "status").stdout
    assert "the queue is running" in fleet.tutti("queue", "start").stdout
    assert fleet.wait(queued).state == "done"
    assert is_referenced(fleet)


def test_at_rest_the_queue_goes_on(fleet: SharedFleet) -> None:
    lose_leader(fleet)
    shown = fleet.tutti("queue", "status").stdout
    assert "the queue is running" in shown and "one copy" in shown
    assert fleet.run(BACK).state == "done"


def test_a_leader_hands_over_at_rest_and_stands_by(fleet: SharedFleet) -> None:
    first, epoch = fleet.find_leader(), fleet.epoch()
    shown = fleet.tutti("coordinator", "hand-over")
    assert shown.returncode == 0 and "handed over" in shown.stdout, shown.stderr
    wait_until(lambda: fleet.epoch() > epoch, "the other one leads")
    assert fleet.find_leader() != first
    assert is_referenced(fleet)
    assert fleet.run(BACK).state == "done"
    wait_until(fleet.has_standby, "the first one stands by")
    assert fleet.parts[first].process.poll() is None


def test_a_leader_without_its_database_ends_itself_once(fleet: SharedFleet, server: PostgresServer) -> None:
    epoch, before = fleet.epoch(), len(fleet.log("coordinator"))
    running = fleet.slow_move()
    queued = fleet.submit(BACK)
    server.suspend()
    lost_ns = raw_ns()
    try:
        wait_until(lambda: count_endings(fleet, before) > 0, "the leader ends")
        assert margin_s(lost_ns, raw_ns()) < LEASE_S + BUSY_S
        for name in SLOW_AXES:
            assert margin_s(lost_ns, fleet.rest_ns(name)) < LEASE_S + BUSY_S
        wait_until(lambda: margin_s(lost_ns, raw_ns()) > SUSPENDED_S, "both have tried the database")
    finally:
        server.resume()
    starts = [fleet.starts(name) for name in SLOW_AXES]
    wait_until(lambda: fleet.epoch() > epoch, "one of them leads")
    assert fleet.wait(running).state == "interrupted"
    fleet.works()
    assert count_endings(fleet, before) == 1 and [fleet.starts(name) for name in SLOW_AXES] == starts
    fleet.tutti("queue", "start")
    assert fleet.wait(queued).state == "done"
    assert all(fleet.parts[name].process.poll() is None for name in NAMES)


def count_endings(fleet: SharedFleet, before: int) -> int:
    """How often a leader has ended since, for its lease."""
    return sum(
        "the lease of the leader could not be renewed" in entry["text"] for entry in fleet.log("coordinator")[before:]
    )
