"""The table of roles against a running router: what arrives of each act, with the names in the certificates."""

import asyncio
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import zenoh
from children import LIMIT_S, wait_until
from fleet import COMMAND, EXAMPLES, free_port
from zenoh.handlers import Callback

from orchestrator.bus.identity import VARIABLE, BadIdentity
from orchestrator.bus.zenoh.sessions import RouterUnreachable, open_session
from orchestrator.client import Tutti
from orchestrator.keys.folder import KeyFolder
from orchestrator.keys.names import USER_ROLES
from orchestrator.model.errors import Refusal

pytestmark = pytest.mark.live

# Below tutti/v1/lab/; the fourth key is tutti/** each time. `+` arrives, `-` does not. `reader`: all roles but the
# button. It is written by hand, so that a fault of the product's table is not repeated here.
TABLE = """
# role        act     own                          another's                  wildcard over it      arrives
coordinator   put     leader                       ctl/gantry/state           *                     + - - -
coordinator   get     ctl/gantry/cmd/arm           svc/submit                 ctl/*/cmd/*           + - + -
coordinator   serve   svc/submit                   ctl/gantry/state           **                    + - - -
coordinator   reply   svc/submit                   ctl/gantry/state           svc/**                + - - -
coordinator   token   live/coordinator/a/1         live/host/left/1           live/*/*/*            + - - -
host          put     host/left/states             host/right/states          host/*/states         + - - -
host          get     time                         ctl/stage/cmd/stop         **                    + - - -
host          serve   ctl/gantry/cmd/arm           ctl/stage/cmd/arm          ctl/**                + - - -
host          reply   host/left/states             host/right/states          host/*/states         + - - -
host          token   live/controller/gantry/1     live/controller/stage/1    live/controller/*/*   + - - -
operator      put     session/s1                   leader                     *                     + - - -
operator      get     svc/submit                   ctl/gantry/cmd/raw         ctl/*/cmd/*           + - - -
operator      serve   kept-estop/operator          svc/submit                 svc/*                 - - - -
operator      reply   kept-estop/operator          svc/submit                 svc/*                 - - - -
operator      token   live/operator/anna/1         live/coordinator/a/2       live/*/*/*            + - - -
maintainer    put     estop-reset                  queue                      *                     + - - -
maintainer    get     ctl/gantry/cmd/raw           ctl/gantry/cmd/commit      ctl/*/cmd/*           + - - -
maintainer    serve   time                         leads/a                    leads/*               - - - -
maintainer    reply   time                         leads/a                    leads/*               - - - -
maintainer    token   live/maintainer/anna/1       live/operator/anna/2       live/*/*/*            + - - -
gateway       put     log/gateway/lab              lease/gantry               lease/**              + - - -
gateway       get     ctl/gantry/cmd/jog           host/left/cmd/arm          ctl/*/cmd/*           + - - -
gateway       serve   kept-estop/gateway           lease/gantry               lease/**              - - - -
gateway       reply   kept-estop/gateway           lease/gantry               lease/**              - - - -
gateway       token   live/gateway/a/1             live/controller/gantry/2   live/*/*/*            + - - -
viewer        put     log/viewer/anna              job/j1/state               **                    - - - -
viewer        get     svc/list                     svc/submit                 svc/*                 + - - -
viewer        serve   kept-estop/viewer            alarm/a1                   alarm/*               - - - -
viewer        reply   kept-estop/viewer            alarm/a1                   alarm/*               - - - -
viewer        token   live/viewer/anna/1           live/host/left/2           live/*/*/*            - - - -
recorder      put     alarm-request/recorder/disk  alarm/a1                   alarm-request/*/*     + - - -
recorder      get     ctl/gantry/event             ctl/gantry/cmd/stop        ctl/*/*               + - - -
recorder      serve   time                         ctl/gantry/trace           ctl/*/trace           - - - -
recorder      reply   time                         ctl/gantry/trace           ctl/*/trace           - - - -
recorder      token   live/recorder/a/1            live/gateway/a/2           live/*/*/*            + - - -
estop-button  put     estop                        estop-reset                *                     + - - -
estop-button  get     ctl/gantry/state             svc/stop                   ctl/*/state           - - - -
estop-button  serve   kept-estop/button            time                       kept-estop/*          - - - -
estop-button  reply   kept-estop/button            time                       kept-estop/*          - - - -
estop-button  token   live/estop-button/door/1     live/host/left/3           live/*/*/*            - - - -
router        put     estop                        leader                     *                     - - - -
router        get     ctl/gantry/cmd/stop          ctl/gantry/cmd/jog         ctl/*/cmd/*           + - - -
router        serve   kept-estop/router-main       kept-estop/a               kept-estop/*          + - - -
router        reply   kept-estop/router-main       kept-estop/a               kept-estop/*          + - - -
router        token   live/router/main/1           live/host/left/4           live/*/*/*            - - - -
older         put     ctl/gantry/state             leader                     *                     - - - -
older         get     ctl/gantry/state             svc/list                   **                    - - - -
older         serve   ctl/gantry/cmd/arm           time                       ctl/*/cmd/*           - - - -
older         reply   ctl/gantry/info              time                       ctl/*/info            - - - -
older         token   live/host/left/5             live/coordinator/a/9       live/*/*/*            - - - -
every         delete  ctl/gantry/state             leader                     **                    - - - -
reader        sub     ctl/gantry/state             leader                     **                    + + + -
reader        watch   live/controller/gantry/1     live/host/right/1          live/*/*/*            + + + -
estop-button  sub     ctl/gantry/state             leader                     **                    + - - -
estop-button  watch   live/controller/gantry/1     live/host/right/1          live/*/*/*            + - - -
older         sub     ctl/gantry/state             leader                     **                    - - - -
older         watch   live/controller/gantry/1     live/host/right/1          live/*/*/*            - - - -
"""
PREFIX = "tutti/v1/lab"
NOTHING = f"{PREFIX}/ctl/none/state"  # all but the button may ask for it, and nothing answers
ROLES = ("coordinator", "host", "router", *USER_ROLES, "older")
ACTS = ("put", "delete", "sub", "get", "serve", "reply", "token", "watch")
COLUMNS = ("own", "another's", "wildcard", "tutti/**")

Case = tuple[str, str, str]
"""Role, act, column."""


def read_table() -> tuple[dict[Case, str], dict[Case, bool]]:
    """The key of each case, and whether it arrives."""
    keys: dict[Case, str] = {}
    arrives: dict[Case, bool] = {}
    for line in TABLE.splitlines():
        if not line or line.startswith("#"):
            continue
        role, act, own, others, wild, *marks = line.split()
        readers = [each for each in ROLES if each not in ("estop-button", "older")]
        for each in {"every": ROLES, "reader": readers}.get(role, [role]):
            wanted = [*(f"{PREFIX}/{key}" for key in (own, others, wild)), "tutti/**"]
            for column, key, mark in zip(COLUMNS, wanted, marks, strict=True):
                keys[each, act, column], arrives[each, act, column] = key, mark == "+"
    assert set(keys) == {(role, act, column) for role in ROLES for act in ACTS for column in COLUMNS}
    return keys, arrives


class RolesRouter:
    """`tutti router` for the demo fleet on two hosts, and an identity for each role."""

    def __init__(self, folder: Path) -> None:
        now = datetime.now(UTC)
        self.keys = KeyFolder(folder / "keys")
        self.keys.init("lab", now, 3650)
        self.keys.add("router", "main", now, addresses=("127.0.0.1",))
        self.keys.add("host", "left", now)
        shutil.copytree(self.keys.identity("host-left"), folder / "older")
        self.keys.renew("host-left", now)
        self.keys.add("coordinator", "main", now)
        for role in USER_ROLES:
            self.keys.add(role, "door" if role == "estop-button" else "anna", now)
        self.keys.add("viewer", "late", now - timedelta(days=9), days=8)
        text = (EXAMPLES / "demo.fleet.yaml").read_text().replace("fleet: demo", "fleet: lab")
        text = text.replace("  gantry:\n", "  gantry:\n    host: left\n").replace(
            "  stage:\n", "  stage:\n    host: right\n"
        )
        fleet = folder / "lab.fleet.yaml"
        fleet.write_text(text)
        self.folder, self.tls, self.socket = folder, f"tls/127.0.0.1:{free_port()}", f"unixsock-stream/{folder}/bus"
        command = [*COMMAND, "router", str(fleet), "--keys", str(self.keys.folder), "--state", str(folder / "state")]
        self.process = subprocess.Popen(
            [*command, "--listen", f"{self.tls},{self.socket}"], stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline().startswith("router on")

    def identity(self, role: str) -> Path:
        if role == "older":
            return self.folder / "older"
        names = {"host": "host-left", "estop-button": "estop-button-door"}
        main = f"{role}-main" if role in ("coordinator", "router") else f"{role}-anna"
        return self.keys.identity(names.get(role, main))

    def open(self, identity: Path | None) -> zenoh.Session:
        """A session with an identity; without one, with all rights, through the socket."""
        if identity is None:
            return open_session(self.socket)
        os.environ[VARIABLE] = str(identity)
        try:
            return open_session(self.tls)
        finally:
            del os.environ[VARIABLE]

    def close(self) -> None:
        self.process.terminate()
        self.process.communicate(timeout=LIMIT_S)


@pytest.fixture(scope="module")
def router() -> Generator[RolesRouter]:
    with TemporaryDirectory() as folder:
        made = RolesRouter(Path(folder))
        try:
            yield made
        finally:
            made.close()


class Trial:
    """All acts of all roles, beside an observer that has all rights."""

    def __init__(self, router: RolesRouter) -> None:
        self.keys, arrives = read_table()
        self.wanted = {case for case, yes in arrives.items() if yes}
        self.arrived: set[Case] = set()
        self.observer = router.open(None)
        self.sessions = {role: router.open(router.identity(role)) for role in ROLES}
        self._held: list[object] = []
        self._marks: set[str] = set()
        self._lock = threading.Lock()

    def note(self, case: Case) -> None:
        with self._lock:
            self.arrived.add(case)

    def cases(self, role: str, act: str) -> list[tuple[Case, str]]:
        return [((role, act, column), self.keys[role, act, column]) for column in COLUMNS]

    def fence(self) -> None:
        """Wait until the router has passed on what every session has sent, and the observer has received it."""
        for role, session in self.sessions.items():
            if role == "older":
                time.sleep(0.3)  # nothing that it sends has an effect which could be waited for
            elif role == "estop-button":
                self._send_until(session, "estop", role)
            else:
                list(session.get(NOTHING, timeout=LIMIT_S))
        self._send_until(self.sessions["coordinator"], "leader", "end")

    def _send_until(self, session: zenoh.Session, key: str, words: str) -> None:
        """Send until the observer receives it: what was sent before has been passed on then, or never will be."""
        with self._lock:
            self._marks.discard(words)

        def received() -> bool:
            session.put(f"{PREFIX}/{key}", words)
            return words in self._marks

        wait_until(received, f"{words} arrives")

    def receive(self, sample: zenoh.Sample) -> None:
        words = sample.payload.to_string() if sample.kind == zenoh.SampleKind.PUT else ""
        with self._lock:
            self._marks.add(words)
        role, _, column = words.partition("|")
        if sample.kind == zenoh.SampleKind.PUT and column:
            self.note((role, "put", column))
        elif sample.kind == zenoh.SampleKind.DELETE:
            self.note((sample.attachment.to_string() if sample.attachment else "?", "delete", "own"))

    # Acts

    def send(self) -> None:
        """put, delete: at an observer of everything."""
        self._held.append(self.observer.declare_subscriber("**", self.receive))
        # The subscription has reached the router, before anything is sent once.
        self._send_until(self.sessions["coordinator"], "leader", "begin")
        block = zenoh.CongestionControl.BLOCK  # else a full queue of a busy machine drops it
        for role, session in self.sessions.items():
            for (_, _, column), key in self.cases(role, "put"):
                session.put(key, f"{role}|{column}", congestion_control=block)
            for _, key in self.cases(role, "delete"):
                session.delete(key, attachment=role, congestion_control=block)
        self.fence()

    def receive_all(self) -> None:
        """sub, watch: of what the observer publishes and announces. A session delivers all it gets to each of its own
        subscribers: so each column has a key of its own."""
        published = dict(zip(COLUMNS, ("lab/ctl/gantry/state", "lab/leader", "lab/queue", "other/queue"), strict=True))
        present = ("lab/live/controller/gantry/1", "lab/live/host/right/1", "lab/live/host/c/1", "other/live/host/a/1")
        announced = dict(zip(COLUMNS, present, strict=True))
        tokens = [self.observer.liveliness().declare_token(f"tutti/v1/{key}") for key in announced.values()]
        declared: list[zenoh.Subscriber[None]] = []

        def make_receiver(case: Case, key: str) -> Callable[[zenoh.Sample], None]:
            return lambda sample: self.note(case) if str(sample.key_expr) == f"tutti/v1/{key}" else None

        for role, session in self.sessions.items():
            for case, key in self.cases(role, "sub"):
                declared.append(session.declare_subscriber(key, make_receiver(case, published[case[2]])))
            for case, key in self.cases(role, "watch"):
                receiver = make_receiver(case, announced[case[2]])
                declared.append(session.liveliness().declare_subscriber(key, receiver, history=True))
        self.fence()
        wanted = {each for each in self.wanted if each[1] in ("sub", "watch")}

        def arrived() -> bool:
            for key in published.values():
                self.observer.put(f"tutti/v1/{key}", "published")
            return wanted <= self.arrived

        wait_until(arrived, "all samples")
        self.fence()
        for each in (*declared, *tokens):
            each.undeclare()

    def ask(self) -> None:
        """get: answered by the observer."""
        asked: set[str] = set()

        def answer(query: zenoh.Query) -> None:
            asked.add(query.payload.to_string() if query.payload else "")
            query.drop()

        served = self.observer.declare_queryable("**", Callback(answer, indirect=False))

        def is_served() -> bool:
            list(self.sessions["coordinator"].get(self.keys["coordinator", "get", "own"], payload="ready", timeout=2.0))
            return "ready" in asked

        wait_until(is_served, "the observer serves")
        with ThreadPoolExecutor(len(self.sessions)) as pool:
            for session, role in ((session, role) for role, session in self.sessions.items()):
                for (_, _, column), key in self.cases(role, "get"):
                    pool.submit(lambda s=session, k=key, w=f"{role}|{column}": list(s.get(k, payload=w, timeout=2.0)))
        for words in asked - {"", "ready"}:
            role, _, column = words.partition("|")
            self.note((role, "get", column))
        served.undeclare()

    def serve(self) -> None:
        """serve, reply: what a query of the observer reaches, and what comes back."""
        for act, role in ((act, role) for act in ("serve", "reply") for role in self.sessions):
            session = self.sessions[role]
            if act == "serve":
                for case, key in self.cases(role, act):
                    self._try_served(session, key, key.replace("**", "x/y").replace("*", "x"), case)
            else:
                own = self.keys[role, act, "own"]
                for case, key in self.cases(role, act):
                    self._try_reply(session, own, key, case)

    def _try_served(self, session: zenoh.Session, key: str, asked: str, case: Case) -> None:
        def answer(query: zenoh.Query) -> None:
            if query.payload is not None:  # else of the session itself
                self.note(case)
            query.drop()

        served = session.declare_queryable(key, Callback(answer, indirect=False))
        self.settle(session, case, lambda: list(self.observer.get(asked, payload=b"observer", timeout=2.0)))
        served.undeclare()

    def _try_reply(self, session: zenoh.Session, own: str, key: str, case: Case) -> None:
        def answer(query: zenoh.Query) -> None:
            with suppress(zenoh.ZError):
                query.reply(key, "reply")
            query.drop()

        def ask() -> None:
            replies = self.observer.get(f"{own}?_anyke", timeout=2.0)
            if any(each.ok is not None and str(each.ok.key_expr) == key for each in replies):
                self.note(case)

        served = session.declare_queryable(own, Callback(answer, indirect=False))
        self.settle(session, case, ask)
        served.undeclare()

    def settle(self, session: zenoh.Session, case: Case, ask: Callable[[], object]) -> None:
        """Ask once the declaration has been passed on, or denied."""
        if case[0] in ("older", "estop-button"):
            time.sleep(0.02)
        else:
            list(session.get(NOTHING, timeout=2.0))
        ask()
        if case not in self.arrived and case in self.wanted:
            wait_until(lambda: (ask(), case in self.arrived)[1], f"{case} arrives")

    def announce(self) -> None:
        """token: at an observer that watches all."""
        seen: set[str] = set()

        def receive(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                seen.add(str(sample.key_expr))

        # With those that are there already: the first token is waited for, so that later ones find a watch that works.
        self._held.append(self.observer.liveliness().declare_subscriber("**", receive, history=True))
        for role, session in self.sessions.items():
            for case, key in self.cases(role, "token"):
                token = session.liveliness().declare_token(key)
                self.settle(session, case, partial(self._note_seen, case, key, seen))
                token.undeclare()

    def _note_seen(self, case: Case, key: str, seen: set[str]) -> None:
        list(self.observer.get(NOTHING, timeout=2.0))
        if key in seen:
            self.note(case)

    def close(self) -> None:
        self._held.clear()
        for session in (*self.sessions.values(), self.observer):
            session.close()


def test_what_arrives_is_what_the_table_of_roles_says(router: RolesRouter) -> None:
    trial = Trial(router)
    try:
        trial.send()
        trial.receive_all()
        trial.ask()
        trial.serve()
        trial.announce()
    finally:
        trial.close()
    assert not trial.wanted - trial.arrived, f"did not arrive: {sorted(trial.wanted - trial.arrived)}"
    assert not trial.arrived - trial.wanted, f"arrived, and must not: {sorted(trial.arrived - trial.wanted)}"


def ask_time(session: zenoh.Session) -> int:
    """How many answer for the fleet's time."""
    return len(list(session.get(f"{PREFIX}/time", timeout=2.0)))


def test_a_certificate_that_does_not_count_is_named_with_its_fault(
    router: RolesRouter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No certificate, an expired one, one of another authority, a router under another address."""
    monkeypatch.delenv(VARIABLE, raising=False)
    with pytest.raises(BadIdentity, match=r"needs a certificate; .* --identity, or TUTTI_IDENTITY"):
        open_session(router.tls)
    with pytest.raises(BadIdentity, match=r"viewer-late\.1 has expired on .* renew it"):
        router.open(router.keys.identity("viewer-late"))
    other = KeyFolder(tmp_path / "keys")
    other.init("lab", datetime.now(UTC), 3650)
    other.add("viewer", "anna", datetime.now(UTC))
    stranger = other.identity("viewer-anna")
    monkeypatch.setenv(VARIABLE, str(stranger))
    with pytest.raises(RouterUnreachable, match=r"as viewer-anna\.1: the certificate of the router .* is not accepted"):
        open_session(router.tls, 0.3)
    (stranger / "ca.pem").write_bytes((router.keys.folder / "ca.pem").read_bytes() + (stranger / "ca.pem").read_bytes())
    with pytest.raises(RouterUnreachable, match=r"certificate viewer-anna\.1 is not accepted by the router"):
        open_session(router.tls, 0.3)
    monkeypatch.setenv(VARIABLE, str(router.identity("viewer")))
    with pytest.raises(RouterUnreachable, match="the router's certificate is not for localhost"):
        open_session(router.tls.replace("127.0.0.1", "localhost"), 0.3)


def test_several_endpoints_are_tried_in_turn(router: RolesRouter, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(router.identity("viewer")))
    with open_session(f"tls/127.0.0.1:{free_port()},{router.tls}") as session:
        assert ask_time(session) == 0
        assert session.info.routers_zid()


def test_a_changed_table_counts_once_the_fleet_is_at_rest(router: RolesRouter) -> None:
    """An operator that is revoked does not reach anything any more; the others connect again by themselves."""
    observer, anna, ben = router.open(None), *map(router.open, map(router.identity, ("operator", "maintainer")))
    got: list[str] = []
    observer.declare_subscriber(f"{PREFIX}/estop", lambda sample: got.append(sample.payload.to_string()))

    def arrives(session: zenoh.Session, words: str) -> bool:
        session.put(f"{PREFIX}/estop", words)
        return words in got

    wait_until(lambda: arrives(anna, "anna before"), "an e-stop of the operator")
    router.keys.revoke("operator-anna")
    wait_until(lambda: arrives(ben, "ben between") and not router_admits(router, "operator"), "the new table")
    wait_until(lambda: arrives(ben, "ben after"), "an e-stop of the maintainer")
    assert not arrives(anna, "anna after")
    for each in (observer, anna, ben):
        each.close()


def test_without_a_coordinator_a_name_that_counts_is_not_blamed(router: RolesRouter) -> None:
    async def ask() -> None:
        async with Tutti(router.tls, "lab", "test") as tutti:
            await tutti.list_jobs()

    for role, text in (
        ("viewer", "fleet lab has no active coordinator"),
        ("older", r"not allowed as host-left\.1: not"),
    ):
        os.environ[VARIABLE] = str(router.identity(role))
        try:
            with pytest.raises(Refusal, match=f"^{text}"):
                asyncio.run(ask())
        finally:
            del os.environ[VARIABLE]


def router_admits(router: RolesRouter, role: str) -> bool:
    """Whether a fresh session of a role may look: the router itself answers which e-stop it keeps."""
    with router.open(router.identity(role)) as session:
        return bool(list(session.get(f"{PREFIX}/kept-estop/router-main", timeout=2.0)))


def test_the_price_of_tls(router: RolesRouter, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Prints the median of requests with TLS, mutual TLS and the table, beside those without."""
    plain_endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [*COMMAND, "router", "--listen", plain_endpoint, "--state", str(tmp_path)]
    environment = {name: value for name, value in os.environ.items() if name != "TUTTI_KEYS"}
    plain = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert plain.stdout is not None
    assert plain.stdout.readline().startswith("router on")
    key = f"{PREFIX}/ctl/gantry/state"
    pairs = {
        "tcp": (open_session(plain_endpoint), open_session(plain_endpoint)),
        "tls": (router.open(router.identity("host")), router.open(router.identity("viewer"))),
    }
    taken_ns: dict[str, list[int]] = {name: [] for name in pairs}

    def answer(query: zenoh.Query) -> None:
        query.reply(key, b"x" * 900)
        query.drop()

    def ask(client: zenoh.Session) -> bool:
        return len(list(client.get(key, timeout=2.0))) == 1

    try:
        served = [server.declare_queryable(key, Callback(answer, indirect=False)) for server, _ in pairs.values()]
        for _, client in pairs.values():
            wait_until(partial(ask, client), "it is served")
        for name, (_, client) in list(pairs.items()) * 300:
            begun_ns = time.perf_counter_ns()
            assert ask(client)
            taken_ns[name].append(time.perf_counter_ns() - begun_ns)
        for each in served:
            each.undeclare()
    finally:
        for session in (session for pair in pairs.values() for session in pair):
            session.close()
        plain.terminate()
        plain.communicate(timeout=LIMIT_S)
    medians = {name: sorted(each)[150] for name, each in taken_ns.items()}
    ratio = medians["tls"] / medians["tcp"]
    with capsys.disabled():
        sys.stdout.write(
            f"\nrequest p50: tcp {medians['tcp'] // 1000} us, tls {medians['tls'] // 1000} us, ratio {ratio:.2f}\n"
        )
    assert ratio < 10
