"""Two coordinators on one journal in PostgreSQL, as on two computers: the leader is lost, hands over, or cannot reach its
database."""

import json
from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from children import wait_until
from fleet import SLOW_AXES, Steps, margin_s, run_tutti
from shared_fleet import NAMES, SharedFleet

pytest.importorskip("psycopg")
from unit.journal.conftest import require_server
from unit.journal.servers import PostgresServer, find_programs
from unit.journal.test_postgres_copies import run_pair

from orchestrator.clock.live import raw_ns
from orchestrator.model.queue import JournalPolicy

pytestmark = [pytest.mark.live, pytest.mark.alone, pytest.mark.postgres]

TAKE_OVER_S = 5.0
LEASE_S = 3.0
SUSPENDED_S = 12.0  # of the database: several tries to connect end meanwhile
BUSY_S = 4.0  # margin for a busy machine, including an interpreter's start
TEN_SECONDS: Steps = [{"do": "move", "to": {"gantry.x": 101, "stage.u": 11}, "speed": 0.1}]
BACK: Steps = [{"do": "move", "to": {"gantry.x": 5, "stage.u": 2}}]


class Site(SharedFleet):
    """The fleet with its servers. standby: of the database; none with one copy."""

    def __init__(self, folder: Path, primary: PostgresServer, standby: PostgresServer | None) -> None:
        servers = [primary] if standby is None else [primary, standby]
        hosts = ",".join(f"127.0.0.1:{server.port}" for server in servers)
        copies = 1 if standby is None else 2
        super().__init__(folder, f"postgresql://tutti@{hosts}/journal", JournalPolicy(copies=copies))
        self.primary = primary
        self.standby = standby

    @property
    def mode(self) -> str:
        """On how many machines the journal is, as the queue says."""
        return self.ask(lambda tutti: tutti.list_jobs(limit=1)).journal or ""


@contextmanager
def run_primary() -> Generator[PostgresServer]:
    require_server()
    primary = PostgresServer(find_programs())
    try:
        primary.create()
        primary.execute("CREATE DATABASE journal")
        yield primary
    finally:
        primary.remove()


@pytest.fixture(scope="module", params=["one copy", "two copies"])
def running(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("shared")
    with ExitStack() as stack:
        if request.param == "one copy":
            site = Site(folder, stack.enter_context(run_primary()), None)
        else:
            pair = stack.enter_context(run_pair())
            site = Site(folder, pair.primary, pair.standby)
        stack.callback(site.close)
        site.start()
        yield site


@pytest.fixture
def fleet(running: Site) -> Site:
    """The fleet of all tests here, at rest, with its queue started and a standby."""
    running.bring_back()
    wait_until(running.has_standby, "a coordinator stands by")
    return running


def lose_leader(fleet: Site) -> None:
    """Kill the leader's processes; the other coordinator leads in time."""
    first, epoch = fleet.find_leader(), fleet.epoch()
    lost_ns = raw_ns()
    fleet.parts[first].kill()
    wait_until(lambda: fleet.epoch() > epoch, "the other one leads")
    assert margin_s(lost_ns, raw_ns()) < TAKE_OVER_S + BUSY_S
    assert fleet.find_leader() != first
    fleet.start_coordinator(first)


def is_referenced(fleet: Site) -> bool:
    states = fleet.status()
    return states["gantry"].axes["x"].referenced and states["stage"].axes["u"].referenced


def test_a_motion_is_interrupted_when_its_leader_dies(fleet: Site) -> None:
    running = fleet.slow_move()
    queued = fleet.submit(BACK)
    lose_leader(fleet)
    report = fleet.wait(running)
    assert report.state == "interrupted", report.reason
    assert "the queue is stopped" in fleet.tutti("queue", "status").stdout
    assert "the queue is running" in fleet.tutti("queue", "start").stdout
    assert fleet.wait(queued).state == "done"
    assert is_referenced(fleet)


def test_at_rest_the_queue_goes_on(fleet: Site) -> None:
    lose_leader(fleet)
    shown = fleet.tutti("queue", "status").stdout
    assert "the queue is running" in shown and f"journal: {fleet.mode}" in fleet.tutti("status").stdout
    assert fleet.run(BACK).state == "done"


def test_a_leader_hands_over_at_rest_and_stands_by(fleet: Site) -> None:
    first, epoch = fleet.find_leader(), fleet.epoch()
    shown = fleet.tutti("coordinator", "hand-over")
    assert shown.returncode == 0 and "handed over" in shown.stdout, shown.stderr
    wait_until(lambda: fleet.epoch() > epoch, "the other one leads")
    assert fleet.find_leader() != first
    assert is_referenced(fleet)
    assert fleet.run(BACK).state == "done"
    wait_until(fleet.has_standby, "the first one stands by")
    assert fleet.parts[first].process.poll() is None


def test_a_leader_without_its_database_ends_itself_once(fleet: Site) -> None:
    epoch, before = fleet.epoch(), len(fleet.log("coordinator"))
    running = fleet.slow_move()
    queued = fleet.submit(BACK)
    fleet.primary.suspend()
    lost_ns = raw_ns()
    try:
        wait_until(lambda: count_endings(fleet, before) > 0, "the leader ends")
        assert margin_s(lost_ns, raw_ns()) < LEASE_S + BUSY_S
        for name in SLOW_AXES:
            assert margin_s(lost_ns, fleet.rest_ns(name)) < LEASE_S + BUSY_S
        wait_until(lambda: margin_s(lost_ns, raw_ns()) > SUSPENDED_S, "both have tried the database")
    finally:
        fleet.primary.resume()
    starts = [fleet.starts(name) for name in SLOW_AXES]
    wait_until(lambda: fleet.epoch() > epoch, "one of them leads")
    assert fleet.wait(running).state == "interrupted"
    fleet.works()
    assert count_endings(fleet, before) == 1 and [fleet.starts(name) for name in SLOW_AXES] == starts
    fleet.tutti("queue", "start")
    assert fleet.wait(queued).state == "done"
    assert all(fleet.parts[name].process.poll() is None for name in NAMES)


def count_endings(fleet: Site, before: int) -> int:
    """How often a leader has ended since, for its lease."""
    return sum(
        "the lease of the leader could not be renewed" in entry["text"] for entry in fleet.log("coordinator")[before:]
    )


def test_without_its_copy_the_journal_takes_no_job_and_the_one_that_runs_ends(fleet: Site) -> None:
    if fleet.standby is None:
        assert fleet.mode == "one copy"
        return
    assert fleet.mode == "two copies"
    epoch = fleet.epoch()
    running = fleet.slow_move(TEN_SECONDS)
    fleet.standby.kill()
    wait_until(lambda: fleet.mode == "waits for a copy", "the coordinator misses it")
    assert fleet.epoch() == epoch
    for command in (("queue", "status"), ("status",)):
        assert "waits for a copy" in fleet.tutti(*command).stdout
    refused = fleet.tutti("submit", str(fleet.file(BACK)), "--json")
    shown = json.loads(refused.stdout)
    assert (refused.returncode, shown["code"]) == (1, "journal"), refused
    assert "the copy of the journal on a second machine is missing; no job is accepted" in shown["text"]
    assert "look at the standby server" in shown["remedy"]
    assert fleet.wait(running).state == "done"
    fleet.standby.start()
    wait_until(lambda: fleet.mode == "two copies", "the coordinator sees it")
    assert fleet.run(BACK).state == "done"


def test_a_coordinator_that_cannot_begin_says_why_in_a_line(running: Site, tmp_path: Path) -> None:
    primary = running.primary
    primary.execute("CREATE ROLE locked LOGIN PASSWORD 'right'; GRANT CREATE ON DATABASE journal TO locked")
    primary.execute("CREATE DATABASE latin ENCODING 'LATIN1' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0")
    host = f"127.0.0.1:{primary.port}"
    cases = (
        (f"postgresql://locked:wrong@{host}/journal", running.endpoint, 1, "the password is wrong or missing"),
        (f"postgresql://tutti@{host}/latin", running.endpoint, 1, "its encoding is LATIN1"),
        ("postgresql://tutti@127.0.0.1:1/journal", running.endpoint, 1, "the database cannot be reached"),
        (f"postgresql://tutti@{host}/journal", "tcp/127.0.0.1:1", 3, "no router answered"),
    )
    file = str(running.folder / "demo.fleet.json")
    for journal, connect, code, problem in cases:
        place = ("--connect", connect, "--state", str(tmp_path / "state"))
        ended = run_tutti("coordinator", file, "--journal", journal, *place)
        assert (ended.returncode, ended.stdout) == (code, ""), ended
        (line,) = ended.stderr.splitlines()
        assert problem in line and "wrong@" not in line, line


def test_a_database_that_has_lost_history_is_not_led_on_and_raises_an_alarm_once(fleet: Site, tmp_path: Path) -> None:
    epoch, notices = fleet.epoch(), tmp_path / "notices"
    fleet.primary.execute("DROP DATABASE IF EXISTS lost")
    fleet.primary.execute("CREATE DATABASE lost")
    configuration = json.loads((fleet.folder / "demo.fleet.json").read_text())
    configuration["notify"] = {"command": ["sh", "-c", f"echo $TUTTI_ALARM_KIND $TUTTI_ALARM_TEXT >> {notices}"]}
    configuration.pop("journal", None)
    (tmp_path / "fleet.json").write_text(json.dumps(configuration))
    for name in NAMES:
        fleet.parts[name].kill()
    journal = f"postgresql://tutti@127.0.0.1:{fleet.primary.port}/lost"
    place = ("--journal", journal, "--connect", fleet.endpoint, "--state", str(tmp_path / "state"))
    for _ in range(2):
        ended = run_tutti("coordinator", str(tmp_path / "fleet.json"), *place)
        assert ended.returncode == 1 and "it has lost history" in ended.stdout, ended
        assert "`tutti journal import FILE --journal ADDRESS --replace" in ended.stdout
    (line,) = notices.read_text().splitlines()
    assert line.startswith("journal-history") and f"a controller has seen {epoch}" in line
    for name in NAMES:
        fleet.start_coordinator(name)
    fleet.works()
