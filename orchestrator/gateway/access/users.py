"""The users of a fleet: a file with hashed passwords and tokens, in the state folder.

Passwords are hashed with Argon2id (RFC 9106), tokens with SHA-256: they have 256 random bits, which cannot be guessed.
"""

import hmac
import os
from collections.abc import Generator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Literal

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError
from pydantic import Field, TypeAdapter, ValidationError

from orchestrator.gateway.access.roles import Role
from orchestrator.model.base import Model
from orchestrator.model.errors import Refusal
from orchestrator.model.files.locks import lock_file
from orchestrator.model.files.private_files import (
    UnsafePath,
    open_private_file,
    read_private_file,
    replace_private_file,
)
from orchestrator.model.problems import describe_first_error, first_error_text
from orchestrator.model.queue import Utc

MIN_PASSWORD, MAX_PASSWORD = 8, 1000
MAX_USERS, MAX_TOKENS = 1000, 100
TOKEN_START = "tutti_"

UserName = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]{0,31}$")]
TokenName = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,31}$")]

_NAME: TypeAdapter[str] = TypeAdapter(UserName)
_HASHER = PasswordHasher()


@cache
def _make_dummy_hash() -> str:
    """Verified for an unknown user, so that the time of an answer does not tell which users there are."""
    return _HASHER.hash("a user that does not exist")


class StoredToken(Model):
    """A token of a user. digest: SHA-256 of it. role: at most that of its user. verbs: None: all of the role."""

    digest: str
    role: Role
    verbs: list[str] | None = None
    created_utc: Utc
    expires_utc: Utc


class StoredUser(Model):
    """A user. password: its Argon2id hash; empty: only tokens are accepted. changed_utc: the last change of password
    or role, which ends the sessions before it."""

    role: Role
    password: str = ""
    created_utc: Utc
    changed_utc: Utc
    tokens: dict[TokenName, StoredToken] = Field(default={}, max_length=MAX_TOKENS)


class UserTable(Model):
    """The contents of the file."""

    schema_: Literal["tutti.users/1"] = Field(default="tutti.users/1", alias="schema")
    users: dict[UserName, StoredUser] = Field(default={}, max_length=MAX_USERS)


class UserFile:
    """The file at `path`; it need not exist. All methods raise `Refusal` for a file that cannot be read or written."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def load(self) -> UserTable:
        """All users; none if there is no file."""
        try:
            return UserTable.model_validate_json(read_private_file(self.path))
        except FileNotFoundError:
            return UserTable()
        except ValidationError as error:
            text = f"{self.path}: {describe_first_error(error)}"
            raise Refusal("bad-users", text, "restore the file, or delete it and add the users again") from None
        except (OSError, UnsafePath) as error:
            raise _explain_file_error(self.path, error) from None

    def find_version(self) -> tuple[int, int, int] | None:
        """Tells one state of the file from another one; None: there is none."""
        try:
            stat = self.path.stat()
        except OSError:
            return None
        return stat.st_ino, stat.st_mtime_ns, stat.st_size

    def add_user(self, name: str, role: Role, password: str, utc: str) -> None:
        """Add a user. Raises `Refusal`: codes `user-exists`, `bad-user`, `weak-password`."""
        _require_name(name)
        hashed_password = hash_password(password) if password else ""
        with self._change() as users:
            if name in users:
                raise Refusal("user-exists", f"there is a user {name} already", "change it: `tutti user passwd`")
            users[name] = StoredUser(role=role, password=hashed_password, created_utc=utc, changed_utc=utc)

    def remove_user(self, name: str) -> None:
        """Remove a user with all tokens. Raises `Refusal`: code `no-user`."""
        with self._change() as users:
            _require_user(users, name)
            del users[name]

    def change_password(self, name: str, password: str, utc: str) -> None:
        """Give a user another password; sessions end. Raises `Refusal`: codes `no-user`, `weak-password`."""
        hashed_password = hash_password(password)
        with self._change() as users:
            user = _require_user(users, name)
            users[name] = user.model_copy(update={"password": hashed_password, "changed_utc": utc})

    def change_role(self, name: str, role: Role, utc: str) -> None:
        """Give a user another role; sessions end. Raises `Refusal`: code `no-user`."""
        with self._change() as users:
            user = _require_user(users, name)
            users[name] = user.model_copy(update={"role": role, "changed_utc": utc})

    def add_token(self, name: str, token: str, stored: StoredToken, secret: str) -> str:
        """Make a token for a user; return it, for it is not stored. token: its name. secret: 32 random bytes as text.

        Raises `Refusal`: codes `no-user`, `token-exists`.
        """
        token_text = f"{TOKEN_START}{name}_{secret}"
        with self._change() as users:
            user = _require_user(users, name)
            if token in user.tokens:
                remedy = f"choose another name, or remove it: `tutti user token {name} --remove {token}`"
                raise Refusal("token-exists", f"user {name} has a token {token} already", remedy)
            new_token = stored.model_copy(update={"digest": _digest_token(token_text)})
            users[name] = user.model_copy(update={"tokens": {**user.tokens, token: new_token}})
        return token_text

    def remove_token(self, name: str, token: str) -> None:
        """Remove a token. Raises `Refusal`: codes `no-user`, `no-token`."""
        with self._change() as users:
            user = _require_user(users, name)
            if token not in user.tokens:
                token_list = ", ".join(user.tokens) or "none"
                raise Refusal(
                    "no-token", f"user {name} has no token {token}; there are: {token_list}", "see `tutti user ls`"
                )
            tokens_left = {
                token_name: stored_token for token_name, stored_token in user.tokens.items() if token_name != token
            }
            users[name] = user.model_copy(update={"tokens": tokens_left})

    @contextmanager
    def _change(self) -> Generator[dict[str, StoredUser]]:
        """The users, to be changed; written at the end. One change at a time, of all processes."""
        lock_path = self.path.with_name(f"{self.path.name}.lock")
        try:
            lock = open_private_file(lock_path, os.O_RDWR | os.O_CREAT)
        except (OSError, UnsafePath) as error:
            raise _explain_file_error(lock_path, error) from None
        with os.fdopen(lock, "rb"):
            lock_file(lock)
            users = dict(self.load().users)
            yield users
            try:
                table = UserTable(users=users)
            except ValidationError as error:
                raise Refusal("bad-users", first_error_text(error), "remove users or tokens first") from None
            try:
                replace_private_file(self.path, table.to_json())
            except (OSError, UnsafePath) as error:
                raise _explain_file_error(self.path, error) from None


def hash_password(password: str) -> str:
    """The Argon2id hash of a password. Raises `Refusal`, code `weak-password`."""
    if not MIN_PASSWORD <= len(password) <= MAX_PASSWORD:
        text = f"a password has {MIN_PASSWORD} to {MAX_PASSWORD} characters, this one has {len(password)}"
        raise Refusal("weak-password", text, "choose another one; several words are easy to remember")
    return _HASHER.hash(password)


def verify_password(user: StoredUser | None, password: str) -> bool:
    """Whether it is the password of a user; takes the same time for a user that does not exist."""
    dummy_hash = _make_dummy_hash()  # for every user: the first one of all waits for it
    hashed_password = user.password if user is not None and user.password else dummy_hash
    try:
        _HASHER.verify(hashed_password, password[: MAX_PASSWORD + 1])
    except (VerificationError, InvalidHashError):
        return False
    return user is not None and bool(user.password)


def find_token(table: UserTable, secret: str, utc: str) -> tuple[str, str, StoredToken] | None:
    """User, name and rights of a token. Raises `Refusal`, code `token-expired`; None: there is no such token."""
    name = secret.removeprefix(TOKEN_START).partition("_")[0]
    user = table.users.get(name)
    if user is None:
        return None
    digest = _digest_token(secret)
    for token, stored_token in user.tokens.items():
        if hmac.compare_digest(stored_token.digest, digest):
            if stored_token.expires_utc <= utc:
                text = f"token {token} of {name} expired at {stored_token.expires_utc}"
                raise Refusal("token-expired", text, f"make another one: `tutti user token {name}`")
            return name, token, stored_token
    return None


def _digest_token(secret: str) -> str:
    return sha256(secret.encode()).hexdigest()


def _require_name(name: str) -> None:
    try:
        _NAME.validate_python(name)
    except ValidationError:
        text = f"{name!r} is no name of a user: a-z, 0-9, '.' and '-', at most 32 characters"
        raise Refusal("bad-user", text, "choose another name") from None


def _require_user(users: dict[str, StoredUser], name: str) -> StoredUser:
    if name not in users:
        user_list = ", ".join(sorted(users)) or "none"
        raise Refusal("no-user", f"there is no user {name}; there are: {user_list}", "see `tutti user ls`")
    return users[name]


def _explain_file_error(path: Path, error: OSError | UnsafePath) -> Refusal:
    text = str(error) if isinstance(error, UnsafePath) else f"{path}: {error.strerror}"
    return Refusal("users-file", text, "correct owner and mode of the file and its folder, or free space there")
