"""Users, sessions and tokens, with a clock that is set by hand."""

import asyncio
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from argon2 import PasswordHasher

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.executor import run_inline
from orchestrator.gateway.access import users as users_module
from orchestrator.gateway.access.authentication import (
    LONGEST_SESSION_NS,
    MAX_SESSIONS,
    SESSION_NS,
    Authentication,
    NotSignedIn,
)
from orchestrator.gateway.access.cookies import BrowserMarks, CookieNames, find_cookie, load_key
from orchestrator.gateway.access.identity import Identity
from orchestrator.gateway.access.sign_in_limits import (
    FORGET_NS,
    FREE_FAILURES,
    MAX_ADDRESS_VERIFYING,
    MAX_UNKNOWN_VERIFYING,
    MAX_VERIFYING,
    SignInLimits,
    SignInSource,
    TooManyTries,
)
from orchestrator.gateway.access.users import StoredToken, UserFile
from orchestrator.model.errors import Refusal
from orchestrator.model.queue import format_utc

PASSWORD = "correct horse"
VERIFY = "orchestrator.gateway.access.authentication.verify_password"
BEGIN = datetime(2026, 1, 1, tzinfo=UTC)


class HandClock:
    """A clock that stands until it is moved."""

    kernel_id = "hand"

    def __init__(self) -> None:
        self.at_ns = 0

    def now_ns(self) -> int:
        return self.at_ns

    def utc(self) -> str:
        return format_utc(BEGIN + timedelta(microseconds=self.at_ns // 1000))

    def call_at_ns(self, *_: object, **__: object) -> None:
        raise AssertionError

    def move(self, seconds: float) -> None:
        self.at_ns += round(seconds * NS_PER_S)


class Door:
    """An authentication with a user `olga`."""

    def __init__(self, folder: Path) -> None:
        self.clock = HandClock()
        self.drawn = 0
        self.users = UserFile(folder / "users.json")
        self.users.add_user("olga", "operator", PASSWORD, self.clock.utc())
        self.authentication = Authentication(self.users, self.clock, run_inline, self.draw)  # pyright: ignore[reportArgumentType]

    def draw(self) -> str:
        self.drawn += 1
        return f"secret-{self.drawn}"

    def sign_in(
        self, user: str = "olga", password: str = PASSWORD, address: str = "127.0.0.1", browser: str = ""
    ) -> str:
        """The cookie of a new session."""
        source = SignInSource(address, browser)
        secret, _ = asyncio.run(self.authentication.sign_in(user, password, source))
        return secret

    def identify(self, cookie: str = "", authorization: str = "") -> Identity:
        return self.authentication.identify("127.0.0.1", cookie, authorization)


@pytest.fixture
def door(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Door:
    # The least work for each password: tests have many of them.
    hasher = PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
    monkeypatch.setattr("orchestrator.gateway.access.users._HASHER", hasher)
    return Door(tmp_path)


def test_a_session_lasts_while_it_is_used_and_a_week_at_most(door: Door) -> None:
    cookie = door.sign_in()
    step_s = SESSION_NS / NS_PER_S - 60
    for _ in range(int(LONGEST_SESSION_NS / SESSION_NS)):
        door.clock.move(step_s)
        identity = door.identify(cookie)
    assert door.authentication.is_valid(identity)
    door.clock.move(step_s)
    with pytest.raises(NotSignedIn):
        door.identify(cookie)
    assert not door.authentication.is_valid(identity)


def test_a_session_that_is_not_used_ends(door: Door) -> None:
    cookie = door.sign_in()
    door.clock.move(SESSION_NS / NS_PER_S + 1)
    with pytest.raises(NotSignedIn):
        door.identify(cookie)


def test_of_too_many_sessions_the_oldest_ends(door: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(VERIFY, lambda *_: True)
    cookies = [door.sign_in() for _ in range(MAX_SESSIONS + 1)]
    with pytest.raises(NotSignedIn):
        door.identify(cookies[0])
    assert door.identify(cookies[-1]).user == "olga"


def test_pauses_after_failures_grow_to_five_minutes_and_end_with_success(
    door: Door, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(VERIFY, lambda _, password: password == PASSWORD)
    pauses: list[int] = []
    for _ in range(16):
        waited = 0
        while True:
            try:
                door.sign_in(password="wrong password")
            except TooManyTries:
                door.clock.move(1)
                waited += 1
            except NotSignedIn:
                break
        pauses.append(waited)
    assert pauses[:9] == [0, 0, 0, 0, 0, 1, 2, 4, 8]
    assert pauses[-1] == 300
    door.clock.move(300)
    door.sign_in()
    with pytest.raises(NotSignedIn):
        door.sign_in(password="wrong password")


def test_wrong_passwords_keep_out_neither_another_address_nor_another_user(
    door: Door, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(VERIFY, lambda _, password: password == PASSWORD)
    door.users.add_user("mia", "maintainer", PASSWORD, door.clock.utc())
    door.clock.move(1)
    fail(door, 9, "olga", "192.0.2.1")
    with pytest.raises(TooManyTries, match="wait "):
        door.sign_in("olga", address="192.0.2.1")
    door.sign_in("mia", address="192.0.2.1")
    door.sign_in("olga", address="192.0.2.2")


def test_a_computer_has_one_count_for_its_whole_network_of_ipv6(door: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(VERIFY, lambda _, password: password == PASSWORD)
    for number in range(FREE_FAILURES):
        fail(door, 1, "olga", f"2001:db8::{number}")
    with pytest.raises(TooManyTries):
        door.sign_in("olga", address="2001:db8::99")
    door.sign_in("olga", address="2001:db8:1::1")


def test_a_browser_of_the_user_has_its_own_count_at_the_same_address(
    door: Door, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through a tunnel all have the address 127.0.0.1."""
    monkeypatch.setattr(VERIFY, lambda _, password: password == PASSWORD)
    fail(door, 20, "olga", "127.0.0.1")
    with pytest.raises(TooManyTries):
        door.sign_in()
    door.sign_in(browser="tablet")
    fail(door, FREE_FAILURES, "olga", "192.0.2.9", "tablet")
    with pytest.raises(TooManyTries):
        door.sign_in(browser="tablet")
    door.sign_in(browser="other")


def test_failures_are_forgotten_one_by_one(door: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(VERIFY, lambda _, password: password == PASSWORD)
    for _ in range(50):
        fail(door, 1, "olga", "192.0.2.1")
        door.clock.move(FORGET_NS / NS_PER_S)
    fail(door, FREE_FAILURES - 1, "olga", "192.0.2.1")
    door.sign_in("olga", address="192.0.2.1")


def fail(door: Door, count: int, user: str, address: str, browser: str = "") -> None:
    """Wrong passwords without a pause between them: some are refused unseen."""
    for _ in range(count):
        with pytest.raises((NotSignedIn, TooManyTries)):
            door.sign_in(user, "wrong password", address, browser)


def test_an_unknown_user_costs_the_same_as_a_known_one(door: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also the first sign-in of a process, and that of a user with tokens only."""
    door.users.add_user("ci", "operator", "", door.clock.utc())
    door.clock.move(1)
    for user in ("olga", "eve", "ci"):
        users_module._make_dummy_hash.cache_clear()
        work: list[str] = []
        hasher = users_module._HASHER
        counted = CountedHasher(hasher, work)
        monkeypatch.setattr(users_module, "_HASHER", counted)
        fail(door, 2, user, "192.0.2.1")
        monkeypatch.setattr(users_module, "_HASHER", hasher)
        assert work == ["hash", "verify", "verify"], user


class CountedHasher:
    """Notes what a hasher does."""

    def __init__(self, hasher: PasswordHasher, work: list[str]) -> None:
        self._hasher, self._work = hasher, work

    def hash(self, password: str) -> str:
        self._work.append("hash")
        return self._hasher.hash(password)

    def verify(self, hashed: str, password: str) -> bool:
        self._work.append("verify")
        return self._hasher.verify(hashed, password)


def test_places_for_verifications_are_shared() -> None:
    limits = SignInLimits(HandClock())  # pyright: ignore[reportArgumentType]

    def take(stack: ExitStack, *sources: SignInSource) -> bool:
        try:
            for source in sources:
                stack.enter_context(limits.verify(source))
        except TooManyTries:
            return False
        return True

    for _ in range(2):  # the places are free again afterwards
        with ExitStack() as stack:
            assert take(stack, *[SignInSource("192.0.2.1")] * MAX_ADDRESS_VERIFYING)
            assert not take(stack, SignInSource("192.0.2.1"))
            others = [SignInSource(f"192.0.2.{number}") for number in range(2, MAX_UNKNOWN_VERIFYING)]
            assert take(stack, *others) and not take(stack, SignInSource("192.0.2.99"))
            known = [SignInSource("192.0.2.1", f"tablet {number}") for number in range(MAX_VERIFYING)]
            assert take(stack, *known[: MAX_VERIFYING - MAX_UNKNOWN_VERIFYING])
            assert not take(stack, known[-1])


def test_cookies_have_the_names_of_fleet_and_port(tmp_path: Path) -> None:
    names = CookieNames("demo", 8080)
    assert (names.session, names.name_browser("olga")) == ("tutti_session_demo_8080", "tutti_known_demo_8080_olga")
    assert CookieNames("demo", 8443, secure=True).session == "__Host-tutti_session_demo_8443"
    header = 'odd{"x"}; a=b=c; tutti_session_demo_8081=other; tutti_session_demo_8080=mine; =; ;'
    assert find_cookie(header, names.session) == "mine" and find_cookie(header, "a") == "b=c"
    assert find_cookie(header, "tutti") == "" and find_cookie("", names.session) == ""
    # The mark of a browser is its user's, and counts after a restart.
    mark = BrowserMarks(load_key(tmp_path)).make_mark("olga", "tablet")
    marks = BrowserMarks(load_key(tmp_path))
    assert marks.find_browser("olga", mark) == "tablet" and marks.find_browser("mia", mark) == ""
    for forged in ("", ".", "tablet", "tablet.", mark.replace("tablet", "other"), mark[:-1], "é.é"):
        assert marks.find_browser("olga", forged) == ""
    assert (tmp_path / "browsers.key").stat().st_mode & 0o777 == 0o600
    (tmp_path / "browsers.key").write_bytes(b"short")
    assert BrowserMarks(load_key(tmp_path)).find_browser("olga", mark) == ""


def test_an_identity_without_users_holds_until_there_is_one(tmp_path: Path) -> None:
    clock, users = HandClock(), UserFile(tmp_path / "users.json")
    authentication = Authentication(users, clock, run_inline, lambda: "secret")  # pyright: ignore[reportArgumentType]
    identity = authentication.identify("127.0.0.1", "", "")
    assert (identity.role, identity.access, identity.actor) == ("operator", "open", "operator@127.0.0.1")
    assert authentication.is_valid(identity)
    users.add_user("olga", "operator", PASSWORD, clock.utc())
    clock.move(1)
    assert not authentication.is_valid(identity)


# The file


@pytest.mark.parametrize("name", ["", "Anna", "an na", "../x", "a" * 33, "a_b", "<b>"])
def test_a_name_that_is_none_is_refused(door: Door, name: str) -> None:
    with pytest.raises(Refusal) as refused:
        door.users.add_user(name, "viewer", PASSWORD, door.clock.utc())
    assert refused.value.code == "bad-user"


def test_what_is_not_there_or_there_already_is_refused_in_words(door: Door) -> None:
    utc = door.clock.utc()
    stored = StoredToken(digest="", role="viewer", created_utc=utc, expires_utc=utc)
    door.users.add_token("olga", "ci", stored, "secret")
    for act, code in (
        (lambda: door.users.add_user("olga", "viewer", PASSWORD, utc), "user-exists"),
        (lambda: door.users.add_user("eve", "viewer", "short", utc), "weak-password"),
        (lambda: door.users.change_password("olga", "x" * 2000, utc), "weak-password"),
        (lambda: door.users.remove_user("eve"), "no-user"),
        (lambda: door.users.change_role("eve", "viewer", utc), "no-user"),
        (lambda: door.users.add_token("olga", "ci", stored, "secret"), "token-exists"),
        (lambda: door.users.remove_token("olga", "other"), "no-token"),
    ):
        with pytest.raises(Refusal) as refused:
            act()
        assert refused.value.code == code
        assert refused.value.remedy


def test_the_file_has_no_secrets_and_is_for_its_owner_only(door: Door) -> None:
    utc = door.clock.utc()
    secret = door.users.add_token(
        "olga", "ci", StoredToken(digest="", role="viewer", created_utc=utc, expires_utc=utc), "secret"
    )
    text = door.users.path.read_text()
    assert PASSWORD not in text and secret not in text and "$argon2id$" in text
    assert door.users.path.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("text", ["", "{", "[]", '{"users": {"a": {}}}', '{"schema": "tutti.users/9", "users": {}}'])
def test_a_damaged_file_is_refused_with_its_place(door: Door, text: str) -> None:
    door.users.path.write_text(text)
    for act in (door.users.load, lambda: door.users.add_user("eve", "viewer", PASSWORD, door.clock.utc())):
        with pytest.raises(Refusal) as refused:
            act()
        assert refused.value.code == "bad-users" and "users.json" in refused.value.text
    assert door.users.path.read_text() == text
