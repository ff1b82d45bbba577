"""Users, sessions and tokens, with a clock that is set by hand."""

import asyncio
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from argon2 import PasswordHasher

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.executor import run_inline
from orchestrator.gateway.access.authentication import (
    LONGEST_SESSION_NS,
    MAX_SESSIONS,
    MAX_VERIFYING,
    SESSION_NS,
    Authentication,
    NotSignedIn,
    TooManyTries,
)
from orchestrator.gateway.access.identity import Identity
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

    def sign_in(self, user: str = "olga", password: str = PASSWORD, address: str = "127.0.0.1") -> str:
        """The cookie header of a new session."""
        secret, _ = asyncio.run(self.authentication.sign_in(user, password, address))
        return f"tutti_session={secret}"

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


def test_failures_of_one_address_slow_down_another_user_there_only(door: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(VERIFY, lambda _, password: password == PASSWORD)
    door.users.add_user("mia", "maintainer", PASSWORD, door.clock.utc())
    door.clock.move(1)
    for _ in range(5):
        with pytest.raises(NotSignedIn):
            door.sign_in(password="wrong password", address="192.0.2.1")
    with pytest.raises(TooManyTries):
        door.sign_in("mia", address="192.0.2.1")
    door.sign_in("mia", address="192.0.2.2")


def test_passwords_wait_for_each_other_in_bounded_number(door: Door) -> None:
    begun: list[asyncio.Future[None]] = []

    async def wait(*_: object) -> bool:
        gate = asyncio.get_running_loop().create_future()
        begun.append(gate)
        await gate
        return True

    async def main() -> None:
        authentication = Authentication(door.users, door.clock, wait, door.draw)  # pyright: ignore[reportArgumentType]
        tasks = [
            asyncio.ensure_future(authentication.sign_in("olga", PASSWORD, f"192.0.2.{number}"))
            for number in range(MAX_VERIFYING + 1)
        ]
        await asyncio.sleep(0)
        for gate in begun:
            gate.set_result(None)
        results = await asyncio.gather(*tasks, return_exceptions=True)
        assert sum(isinstance(each, TooManyTries) for each in results) == 1

    asyncio.run(main())


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
