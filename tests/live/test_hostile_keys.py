"""Certificates in the wrong hands, against a running fleet: what each can do is what its role may do, and no more."""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
import zenoh
from children import LIMIT_S, wait_until
from fleet import READY, SLOW_AXES, margin_s, run_tutti, wait_a_moment
from keyed_fleet import KeyedFleet
from zenoh.handlers import Callback

from orchestrator.bus.identity import AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE, VARIABLE
from orchestrator.bus.limits import MAX_BYTES_QUEUED, MAX_COORDINATOR_MESSAGE_BYTES, MAX_MESSAGE_BYTES
from orchestrator.clock.live import raw_ns
from orchestrator.keys.authority import load_authority
from orchestrator.keys.folder import AUTHORITY_KEY_FILE
from orchestrator.model.errors import NotAllowed, Refusal
from orchestrator.model.files.private_files import replace_private_file
from orchestrator.model.jobs.job import Job

pytestmark = [pytest.mark.live, pytest.mark.alone]

PREFIX = "tutti/v1/demo"
MB = 1_000_000
STOPPED_S = 3.0  # from a stop to rest on a busy computer; the demo fleet declares 1.04 s


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[KeyedFleet]:
    fleet = KeyedFleet(tmp_path_factory.mktemp("k"))
    try:
        fleet.started()
        done = run_tutti("journal", "export", "-o", str(fleet.folder / "early.jsonl"), "--state", str(fleet.state))
        assert done.returncode == 0, done.stderr
        yield fleet
    finally:
        fleet.close()


class Collected(list[tuple[str, bytes]]):
    """Samples on an expression on which the running fleet publishes, from now on: the first one has arrived."""

    def __init__(self, session: zenoh.Session, expression: str) -> None:
        super().__init__()
        self.held = session.declare_subscriber(expression, self._receive)
        wait_until(lambda: len(self) > 0, f"a sample on {expression}")

    def _receive(self, sample: zenoh.Sample) -> None:
        self.append((str(sample.key_expr), sample.payload.to_bytes()))


def prepare(fleet: KeyedFleet) -> None:
    """The queue is started, and all axes are enabled and have a reference."""
    states = fleet.status().values()
    axes = [axis for state in states for axis in state.axes.values()]
    if not any(each.estop for each in states) and all(each.enabled and each.referenced for each in axes):
        fleet.works()
        fleet.ask(lambda tutti: tutti.start_queue())
    else:
        fleet.ready()


def settle(session: zenoh.Session) -> None:
    """Wait until the router has taken what a session has sent: it answers a request behind that."""
    list(session.get(f"{PREFIX}/kept-estop/router-main", timeout=5.0))


def test_a_name_that_does_not_count_is_told_apart_from_an_absent_coordinator(keyed: KeyedFleet) -> None:
    """An older generation, a revoked name, one that the table does not have; then a role that may not."""
    for name, folder in keyed.rightless.items():
        with pytest.raises(NotAllowed, match=rf"^not allowed as {name}: not even the router answers it") as caught:
            keyed.ask_as(folder, lambda tutti: tutti.list_jobs())
        assert f"does {name} count" in caught.value.remedy
    job = Job.model_validate_json(keyed.file(READY).read_text())
    with pytest.raises(NotAllowed, match=r"^not allowed as viewer-anna\.2: its role may not do `submit`"):
        keyed.ask_as(keyed.identity("viewer"), lambda tutti: tutti.submit(job))
    stopped = keyed.ask_as(keyed.identity("recorder"), lambda tutti: tutti.stop())
    assert {str(each) for each in stopped.values()} == {"not allowed as recorder-anna.1: its role may not do `stop`"}


def test_what_another_owns_is_not_reached(keyed: KeyedFleet) -> None:
    """The host of the stage claims the gantry, and an operator what the coordinator and the hosts serve; meanwhile a
    job runs."""
    prepare(keyed)
    observer, right, anna = map(keyed.open, (None, keyed.identity("host", "right"), keyed.identity("operator")))
    asked: list[str] = []

    def answer(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        query.drop()

    try:
        states, presence = Collected(observer, f"{PREFIX}/ctl/gantry/state"), list[str]()
        watch = observer.liveliness().declare_subscriber(
            f"{PREFIX}/live/**", lambda each: presence.append(str(each.key_expr)), history=True
        )
        wait_until(lambda: bool(presence), "what the fleet itself has announced")
        forged = json.loads(keyed.status()["gantry"].to_json()) | {"instance": "forged"}
        tokens = [
            right.liveliness().declare_token(f"{PREFIX}/live/{each}/forged")
            for each in ("controller/gantry", "host/left")
        ]
        served = [
            *(
                right.declare_queryable(f"{PREFIX}/{each}", Callback(answer, indirect=False))
                for each in ("ctl/**", "ctl/gantry/**", "ctl/gantry/state", "host/left/**", "host/left/cmd/*")
            ),
            *(
                session.declare_queryable(f"{PREFIX}/{each}", Callback(answer, indirect=False))
                for session in (right, anna)
                for each in ("svc/*", "leads/*", "time", "ctl/*/state", "lease/**")
            ),
        ]
        for session in (right, anna):
            settle(session)
        right.put(f"{PREFIX}/ctl/gantry/state", json.dumps(forged))
        assert keyed.run([{"do": "move", "to": {"gantry.x": 2, "stage.u": 2}}]).state == "done"
        right.put(f"{PREFIX}/ctl/gantry/state", json.dumps(forged))
        settle(right)
        keyed.status()
        assert len(states) > 2 and not any(b"forged" in payload for _, payload in states)
        assert not [each for each in presence if each.endswith("/forged")]
        assert asked == []
        for each in (watch, *tokens, *served):
            each.undeclare()
    finally:
        for session in (observer, right, anna):
            session.close()


def test_a_stolen_key_of_a_host_can_do_what_is_stated(keyed: KeyedFleet) -> None:
    """`docs/explanation/security.md`: it can speak for its own controllers and its guardian, and read everything; it
    cannot command, not even its own controllers, nor speak for others, lead, or touch the e-stop."""
    observer, thief = keyed.open(None), keyed.open(keyed.identity("host", "right"))
    own = ("ctl/stage/state", "ctl/stage/event", "ctl/stage/clock", "ctl/stage/link", "log/controller/stage")
    own += ("log/host/right", "alarm-request/host/right", "host/right/states", "host/right/events")
    others = ("ctl/gantry/state", "ctl/gantry/event", "log/controller/gantry", "log/host/left", "leader", "queue")
    others += ("host/left/states", "host/left/events")
    others += ("estop", "estop-reset", "alarm/x", "lease/stage", "job/x/state", "session/x")
    commands = (
        "ctl/stage/cmd/jog",
        "ctl/stage/cmd/raw",
        "ctl/stage/cmd/stop",
        "ctl/gantry/cmd/reset",
        "host/right/cmd/arm",
    )
    commands += ("svc/submit", "svc/stop", "svc/acquire-axes")
    try:
        seen, read = Collected(observer, f"{PREFIX}/**"), Collected(thief, f"{PREFIX}/**")
        answered = [thief.declare_queryable(f"{PREFIX}/kept-estop/guardian-right", lambda query: query.drop())]
        for key in (*others, *own):
            thief.put(f"{PREFIX}/{key}", "stolen")

        def arrived() -> set[str]:
            return {key.removeprefix(f"{PREFIX}/") for key, payload in seen if payload == b"stolen"}

        wait_until(lambda: set(own) <= arrived(), "what is its own arrives")
        assert arrived() == set(own)
        for key in commands:
            assert list(thief.get(f"{PREFIX}/{key}", payload="{}", timeout=2.0)) == [], key
        tokens = [
            thief.liveliness().declare_token(f"{PREFIX}/live/{each}/t") for each in ("coordinator/a", "host/right")
        ]
        settle(thief)
        present = {str(each.ok.key_expr) for each in observer.liveliness().get(f"{PREFIX}/live/*/*/t") if each.ok}
        assert present == {f"{PREFIX}/live/host/right/t"}
        wait_until(lambda: any("ctl/gantry/state" in key for key, _ in read), "it reads")
        for each in (*answered, *tokens):
            each.undeclare()
        keyed.works()  # what was garbage has moved and stopped nothing
    finally:
        observer.close()
        thief.close()


def memory_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1000


def test_a_payload_of_100_mb_is_left_out_wherever_it_comes(keyed: KeyedFleet) -> None:
    """On a key that the role may use, and on one that it may not; then one that the router still takes."""
    coordinator = keyed.pid("orchestrator.coordinator.process")
    pids = {"coordinator": coordinator, "router": keyed.router.pid}
    before = {name: memory_mb(pid) for name, pid in pids.items()}
    anna = keyed.open(keyed.identity("operator"))
    try:
        for key in ("session/x", "leader"):
            anna.put(f"{PREFIX}/{key}", b"x" * (100 * MB), congestion_control=zenoh.CongestionControl.BLOCK)
    finally:
        anna.close()
    keyed.works()
    anna = keyed.open(keyed.identity("operator"))
    try:
        size = MAX_COORDINATOR_MESSAGE_BYTES + MB
        reply = list(anna.get(f"{PREFIX}/svc/submit", payload=b"x" * size, timeout=LIMIT_S))
        (text,) = [each.err.payload.to_string() for each in reply if each.err]
        limit = f"too large: a request has at most {MAX_COORDINATOR_MESSAGE_BYTES} bytes here, this one {size}; "
        assert text.startswith(limit) and "split the job" in text
    finally:
        anna.close()
    words = f"{size} bytes on {PREFIX}/svc/submit are left out; at most {MAX_COORDINATOR_MESSAGE_BYTES} are taken"
    logs = [keyed.state / "log" / f"coordinator.{kind}" for kind in ("jsonl", "err")]
    wait_until(lambda: any(words in each.read_text() for each in logs), "the coordinator names key and limit")
    grown = {name: memory_mb(pid) - before[name] for name, pid in pids.items()}
    assert all(each < 3 * MAX_MESSAGE_BYTES / MB for each in grown.values()), grown
    sys.stdout.write(f"grown by, MB: {grown}\n")
    keyed.works()


class Flood:
    """A process that puts a payload on keys with the identity of a role, while the context lasts."""

    def __init__(self, fleet: KeyedFleet, folder: Path, payload: bytes, keys: tuple[str, ...]) -> None:
        file = fleet.folder / "flood.payload"
        file.write_bytes(payload)
        command = [sys.executable, str(Path(__file__).with_name("flood.py")), fleet.tls, str(file)]
        self.put = 0
        self._process = subprocess.Popen(
            [*command, *("?" * key.startswith("?") + f"{PREFIX}/{key.lstrip('?')}" for key in keys)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, VARIABLE: str(folder)},
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def __enter__(self) -> "Flood":
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.put = int(self._process.communicate(timeout=LIMIT_S)[0])
        finally:
            self._process.kill()
            self._process.wait()


# What the table lets a role put, but for clock and link of the same controller; `?` stands for requests.
FLOODS = {
    "host": ("right", ("ctl/stage/state", "ctl/stage/event", "log/host/right", "alarm-request/host/right")),
    "operator": ("anna", ("session/x", "log/operator/anna", "estop-reset", "alarm-request/operator/anna")),
    "maintainer": ("anna", ("estop", "session/x")),
    "gateway": ("anna", ("?ctl/gantry/cmd/jog", "?svc/submit", "?ctl/stage/info")),
    "viewer": ("anna", ("leader", "ctl/gantry/state", "estop", "log/viewer/anna")),
}


@pytest.mark.parametrize(
    "role", ["host", *(pytest.param(each, marks=pytest.mark.nightly) for each in FLOODS if each != "host")]
)
def test_a_flood_on_what_a_role_may_use_leaves_the_stop(keyed: KeyedFleet, role: str) -> None:
    """As fast as one process puts, during a move: it goes on or stops safely, and an operator's stop counts in time.
    The payload is a state of the stage at rest, which is valid for its host."""
    prepare(keyed)
    coordinator = keyed.pid("orchestrator.coordinator.process")
    before, payload = memory_mb(coordinator), keyed.status()["stage"].to_json()
    name, keys = FLOODS[role]
    job_id = keyed.slow_move()
    with Flood(keyed, keyed.identity(role, name), payload, keys) as flood:
        wait_a_moment(lambda: False, 1.0)
        at_ns = raw_ns()
        keyed.ask_as(keyed.identity("operator"), lambda tutti: tutti.stop())
        took = {each: margin_s(at_ns, keyed.rest_ns(each)) for each in SLOW_AXES}
        grown = memory_mb(coordinator) - before
    report = keyed.wait(job_id)
    sys.stdout.write(f"{role}: put {flood.put}, at rest after {took}, grown by {grown} MB; {report.reason}\n")
    assert all(each < STOPPED_S for each in took.values()), took
    assert grown < 2 * MAX_BYTES_QUEUED / MB, grown
    assert flood.put > 100, "it floods"
    assert report.state in ("aborted", "failed"), report.reason
    if role != "maintainer":
        keyed.works()  # else it is latched


def test_a_recorded_heartbeat_changes_nothing(keyed: KeyedFleet) -> None:
    """Bytes of the leader's heartbeat, with an e-stop that is over by now, put again by a host, by an operator and with
    the coordinator's own certificate: then, and when that coordinator has a successor."""
    keyed.works()
    observer = keyed.open(None)
    roles = {"host": keyed.identity("host", "right"), "operator": keyed.identity("operator")}
    thieves = {role: keyed.open(folder) for role, folder in roles.items()}
    thieves["coordinator"] = keyed.open(keyed.identity("coordinator", "main"))
    try:
        beats = Collected(observer, f"{PREFIX}/leader")
        keyed.ask(lambda tutti: tutti.estop("for the record"))
        wait_until(lambda: bool(beats and json.loads(beats[-1][1])["estop"]), "a heartbeat with the e-stop")
        recorded = [payload for _, payload in beats if json.loads(payload)["estop"]]
        keyed.ask(lambda tutti: tutti.reset())
        wait_until(lambda: not json.loads(beats[-1][1])["estop"], "a heartbeat without")

        def replay() -> None:
            """For longer than a coordinator may be silent."""
            count = len(beats)
            for _ in range(12):
                for session in thieves.values():
                    for payload in recorded:
                        session.put(f"{PREFIX}/leader", payload)
                settle(thieves["coordinator"])
                time.sleep(0.05)
            states = keyed.status()
            assert all(each.estop is None and each.epoch == keyed.epoch() for each in states.values()), states
            # Those of the host and of the operator have not arrived.
            again = sum(payload in recorded for _, payload in beats[count:])
            assert again == 12 * len(recorded), (again, len(recorded))

        replay()
        epoch = keyed.epoch()
        keyed.kill("orchestrator.coordinator.process")
        wait_until(lambda: keyed.epoch() > epoch, "a successor leads")
        keyed.works()
        replay()
        assert keyed.epoch() == epoch + 1
        keyed.works()
    finally:
        for session in (observer, *thieves.values()):
            session.close()


def test_an_imported_journal_has_an_epoch_above_every_adapter_on_the_bus(keyed: KeyedFleet, tmp_path: Path) -> None:
    """An export of before a restart of the coordinator, taken to another folder while the fleet runs."""
    exported, folder = keyed.folder / "early.jsonl", tmp_path / "elsewhere"
    if keyed.epoch() == 1:
        keyed.kill("orchestrator.coordinator.process")
        wait_until(lambda: keyed.epoch() > 1, "a successor leads")
        keyed.works()
    words = ["journal", "import", str(exported), "--state", str(folder), "--fleet", "demo"]
    for more, epoch in ((["--connect", keyed.endpoint], keyed.epoch() + 1), ([], 2)):
        done = run_tutti(*words, *more, "--json", "--replace")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["epoch"] == epoch
        shutil.rmtree(folder)


def test_each_process_has_the_certificate_of_its_role(keyed: KeyedFleet) -> None:
    """`tutti up --keys`, by what the hosts state, and by the processes' environments."""
    infos = {name: keyed.ask(lambda tutti, each=name: tutti.controller_info(each)) for name in ("gantry", "stage")}
    assert {name: info.certificate and info.certificate.name for name, info in infos.items()} == {
        "gantry": "host-left.1",
        "stage": "host-right.1",
    }
    environment = Path(f"/proc/{keyed.pid('orchestrator.coordinator.process')}/environ").read_bytes().split(b"\0")
    assert f"{VARIABLE}={keyed.identity('coordinator', 'main')}".encode() in environment


def test_revoking_at_once_stops_first_and_then_keeps_the_name_out(keyed: KeyedFleet) -> None:
    """`tutti keys revoke --now`, during a move."""
    prepare(keyed)
    assert keyed.ask_as(keyed.identity("maintainer"), lambda tutti: tutti.list_jobs()).total >= 0
    job_id = keyed.slow_move()
    done = run_tutti("keys", "revoke", "maintainer-anna", "--now", "--keys", str(keyed.keys.folder))
    assert done.returncode == 0, done.stderr
    report = keyed.wait(job_id)
    assert report.state in ("aborted", "failed"), report.reason
    wait_until(lambda: "opens anew" in keyed.router_said.read_text(), "the router opens anew")
    for name in SLOW_AXES:
        assert keyed.rest_ns(name)
    wait_until(lambda: keyed.router_said.read_text().count("router on") > 1, "the router listens")
    with pytest.raises(Refusal, match=r"^not allowed as maintainer-anna\.1"):
        keyed.ask_as(keyed.identity("maintainer"), lambda tutti: tutti.list_jobs())
    keyed.works()
    assert keyed.ask_as(keyed.identity("operator"), lambda tutti: tutti.list_jobs()).total >= 0


@pytest.mark.nightly
def test_a_host_whose_certificate_ends_stops_its_axes(keyed: KeyedFleet) -> None:
    """Its certificate is replaced by one that ends soon, and used from its next connection on, which the coordinator
    does not know: a step that would outlive the one it has stated would be refused."""
    prepare(keyed)
    folder, listened = keyed.identity("host", "right"), keyed.router_said.read_text().count("router on")
    authority = load_authority(
        *((keyed.keys.folder / each).read_bytes() for each in (AUTHORITY_FILE, AUTHORITY_KEY_FILE))
    )
    issued = authority.issue("host-right.1", datetime.now(UTC), 20 / 86400)
    replace_private_file(folder / KEY_FILE, issued.key)
    replace_private_file(folder / CERTIFICATE_FILE, issued.certificate)
    keyed.keys.revoke("estop-button-anna")
    wait_until(lambda: keyed.router_said.read_text().count("router on") > listened, "the router listens again")
    keyed.works()
    job_id = keyed.slow_move()
    report = keyed.wait(job_id)
    assert report.state in ("aborted", "failed"), report.reason
    ended_ns = raw_ns() - round((datetime.now(UTC) - issued.expires).total_seconds() * 1e9)
    rest = {name: margin_s(ended_ns, keyed.rest_ns(name)) for name in SLOW_AXES}
    assert all(0 < each < STOPPED_S + 1 for each in rest.values()), (rest, report.reason)
    sys.stdout.write(f"at rest so long after the end: {rest}; {report.reason}\n")
