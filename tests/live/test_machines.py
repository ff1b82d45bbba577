"""Three computers as network namespaces: one of those that lead dies as a whole, or is cut off."""

from collections.abc import Callable, Iterator

import pytest
from children import wait_until
from fleet import Steps, margin_s

pytest.importorskip("psycopg")
from machines import LEADING, Machines, make_networks
from unit.journal.conftest import require_server

from orchestrator.clock.live import raw_ns

pytestmark = [pytest.mark.live, pytest.mark.alone, pytest.mark.postgres]

LEASE_S = 3.0
TAKE_OVER_S = 5.0  # after the promotion, and the lease
BUSY_S = 4.0  # margin for a busy machine
PLACES = (5, 9, 13)
ROUTER_S = 15.0  # until a session has left a router that is silent
TEN_SECONDS: Steps = [{"do": "move", "to": {"gantry.x": 101, "stage.u": 11}, "speed": 0.1}]


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    require_server()
    with make_networks():
        machines = Machines(tmp_path_factory.mktemp("machines"))
        try:
            machines.start()
            yield machines
        finally:
            machines.close()


def move_to(place: float) -> Steps:
    return [{"do": "move", "to": {"gantry.x": place, "stage.u": place / 2}}]


def lose_leader(running: Machines, lose: Callable[[str], None]) -> tuple[str, list[str]]:
    """Lose the leader's computer in a motion, with jobs in the queue: the next leader is there in time, and goes on with
    them. Returns the computer, and these jobs."""
    leader, epoch = running.find_leader(), running.epoch()
    moving = running.slow_move()
    queued = [running.submit(move_to(place)) for place in PLACES]
    lose(leader)
    if leader == running.primary:
        running.promote()
    promoted_ns = raw_ns()
    wait_until(lambda: running.epoch() > epoch, "another one leads")
    assert margin_s(promoted_ns, raw_ns()) < LEASE_S + TAKE_OVER_S + BUSY_S
    assert running.find_leader() != leader
    assert running.wait(moving).state == "interrupted"
    return leader, queued


def finish(running: Machines, queued: list[str]) -> None:
    """All accepted jobs are there, and are done once. A host whose session is with the dead router is back after 12 s:
    its first state may be of before."""
    wait_until(lambda: margin_s(running.lost_ns, raw_ns()) > ROUTER_S, "all sessions are back")
    running.works()
    starts = running.starts("gantry")
    running.ask(lambda tutti: tutti.start_queue())
    assert [running.wait(job_id).state for job_id in queued] == ["done"] * len(queued)
    assert running.starts("gantry") - starts == len(queued)


@pytest.mark.timeout(240)
@pytest.mark.parametrize("number", range(20))
def test_the_computer_of_the_leader_or_of_the_primary_dies(running: Machines, number: int) -> None:
    running.bring_back()
    primary, leader = running.primary, running.find_leader()
    if number % 2 == 0 or primary in ("c", leader):
        dying, queued = lose_leader(running, running.kill)
    else:
        dying, moving = primary, running.slow_move()
        queued = [running.submit(move_to(place)) for place in PLACES]
        running.kill(dying)
        running.promote()
        # The leader has lost its connection for longer than it may.
        assert running.wait(moving).state == "interrupted"
    finish(running, queued)
    running.revive(dying)


@pytest.mark.timeout(240)
def test_a_leader_that_is_cut_off_with_its_database_ends_when_the_network_is_back(running: Machines) -> None:
    """Its database still takes writes: those of the older line."""
    running.bring_back()
    running.move_primary(running.find_leader())
    running.bring_back()
    leader, queued = lose_leader(running, running.cut_off)
    epoch = running.epoch()
    finish(running, queued)
    running.mend(leader)
    wait_until(lambda: any(f"leads with epoch {epoch}" in entry["text"] for entry in running.log_of(leader)), "it ends")
    assert running.run(move_to(7)).state == "done" and running.epoch() == epoch
    running.rejoin(leader)


@pytest.mark.timeout(240)
def test_without_a_network_between_the_two_computers_one_leads_on(running: Machines) -> None:
    running.bring_back()
    running.move_primary(running.find_leader())  # else the cut is one between the leader and its database
    running.bring_back()
    leader, epoch = running.find_leader(), running.epoch()
    moving = running.slow_move(TEN_SECONDS)
    running.cut(*LEADING)

    def read_ends() -> list[str]:
        entries = [entry for entry in running.log_of(leader) if entry.get("job") == moving]
        return [entry["text"] for entry in entries if entry["text"].startswith(("job is done", "job is failed"))]

    wait_until(lambda: bool(read_ends()), "the job ends")
    # Adapters whose session is with the other router have lost the leader, and stop.
    assert read_ends() == ["job is done"] or "silent" in read_ends()[0]
    assert running.epoch() == epoch
    running.mend(*LEADING)
    wait_until(lambda: running.mode == "two copies", "the standby of the database follows again")
    wait_until(running.has_standby, "the other coordinator is seen again")
    running.bring_back()
    assert running.run(move_to(7)).state == "done" and running.epoch() == epoch
