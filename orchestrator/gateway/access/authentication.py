"""Authentication: users with their sessions and tokens.

Without users, whatever reaches this machine's own address is an operator; where other computers reach the gateway,
nothing is let in without. A file of users that cannot be read lets nothing in.
"""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.executor import Executor
from orchestrator.gateway.access.identity import Identity
from orchestrator.gateway.access.roles import ROLES, Role
from orchestrator.gateway.access.sign_in_limits import SignInLimits, SignInSource
from orchestrator.gateway.access.users import TOKEN_START, UserFile, UserTable, find_token, verify_password
from orchestrator.model.errors import Refusal

SESSION_NS = 12 * 3600 * NS_PER_S  # from the last request on
LONGEST_SESSION_NS = 7 * 24 * 3600 * NS_PER_S
MAX_SESSIONS = 1000  # the one that was not used for the longest time ends
FILE_CHECK_NS = NS_PER_S // 2


@dataclass(slots=True)
class _Session:
    user: str
    begun_ns: int
    used_ns: int
    user_changed_utc: str


class NotSignedIn(Refusal):
    """The request has no valid identity. HTTP status 401."""


class Authentication:
    """Finds the identity of each request. execute: for the verification of passwords, which takes long. new_secret:
    returns 32 random bytes as text. open_without_users: whatever comes is an operator while there are no users."""

    def __init__(
        self,
        file: UserFile,
        clock: Clock,
        execute: Executor,
        new_secret: Callable[[], str],
        *,
        open_without_users: bool = True,
    ) -> None:
        self._file, self._clock, self._execute, self._new_secret = file, clock, execute, new_secret
        self._open_without_users = open_without_users
        self._sessions: OrderedDict[str, _Session] = OrderedDict()
        self._limits = SignInLimits(clock)
        self._table = UserTable()
        self._damage: Refusal | None = None
        self._version: tuple[int, int, int] | None = None
        self._checked_ns = -FILE_CHECK_NS

    @property
    def has_users(self) -> bool:
        """Whether users must sign in."""
        self._read_file()
        return self._damage is not None or bool(self._table.users)

    def identify(self, address: str, session: str, authorization: str) -> Identity:
        """The identity of a request by the cookie of its session, and its header. Raises `NotSignedIn`."""
        self._read_file()
        if self._damage is not None:
            raise NotSignedIn("bad-users", self._damage.text, self._damage.remedy)
        if authorization:
            return self._identify_token(address, authorization)
        if not self._table.users:
            if not self._open_without_users:
                text = "the fleet has no users, and other computers reach this gateway"
                raise NotSignedIn("no-users", text, "add one on its computer: `tutti user add NAME --role operator`")
            return Identity("", "operator", address, "open")
        return self._identify_session(address, session)

    def is_valid(self, identity: Identity) -> bool:
        """Whether an identity that was found before still holds: its session has not ended, its token has not expired,
        its user has the same role. It is asked for open sockets: a session does not end while its page is open."""
        self._read_file()
        if self._damage is not None:
            return False
        if identity.access == "open":
            return not self._table.users
        user = self._table.users.get(identity.user)
        if user is None:
            return False
        if identity.access == "token":
            token = user.tokens.get(identity.token)
            return (
                token is not None
                and token.expires_utc > self._clock.utc()
                and _lower(token.role, user.role) == identity.role
            )
        session = self._sessions.get(identity.csrf)
        if session is None or user.role != identity.role or not self._holds(session):
            return False
        session.used_ns = self._clock.now_ns()
        return True

    async def sign_in(self, user: str, password: str, source: SignInSource) -> tuple[str, Identity]:
        """Begin a session; return its cookie and identity. Raises `TooManyTries`, and `NotSignedIn` for a wrong name or
        password."""
        self._read_file()
        if self._damage is not None:
            raise NotSignedIn("bad-users", self._damage.text, self._damage.remedy)
        self._limits.require_pause(user, source)
        stored_user = self._table.users.get(user)
        with self._limits.verify(source):
            right = await self._execute(verify_password, stored_user, password)
        if not right or stored_user is None:
            self._limits.count_failure(user, source)
            raise NotSignedIn(
                "wrong-password", "user or password is wrong", "try again; `tutti user passwd` sets another one"
            )
        self._limits.forget_failures(user, source)
        secret, now_ns = self._new_secret(), self._clock.now_ns()
        csrf = _derive_csrf(secret)
        self._sessions[csrf] = _Session(user, now_ns, now_ns, stored_user.changed_utc)
        if len(self._sessions) > MAX_SESSIONS:
            self._sessions.popitem(last=False)
        return secret, Identity(user, stored_user.role, source.address, "cookie", csrf)

    def sign_out(self, session: str) -> None:
        """End the session of a cookie, if there is one."""
        self._sessions.pop(_derive_csrf(session), None)

    # Inside

    def _identify_token(self, address: str, authorization: str) -> Identity:
        scheme, _, secret = authorization.partition(" ")
        found_token = None
        if scheme.lower() == "bearer" and secret.startswith(TOKEN_START):
            try:
                found_token = find_token(self._table, secret.strip(), self._clock.utc())
            except Refusal as error:
                raise NotSignedIn(error.code, error.text, error.remedy) from None
        if found_token is None:
            text = "the token is not valid"
            raise NotSignedIn("bad-token", text, "send `Authorization: Bearer TOKEN`; `tutti user token` makes one")
        user, token, stored_token = found_token
        role = _lower(stored_token.role, self._table.users[user].role)
        verbs = None if stored_token.verbs is None else frozenset(stored_token.verbs)
        return Identity(user, role, address, "token", token=token, verbs=verbs)

    def _identify_session(self, address: str, secret: str) -> Identity:
        csrf = _derive_csrf(secret)
        session = self._sessions.get(csrf)
        if session is None or not self._holds(session):
            self._sessions.pop(csrf, None)
            raise NotSignedIn("not-signed-in", "this fleet has users, and you are not signed in", "sign in")
        session.used_ns = self._clock.now_ns()
        self._sessions.move_to_end(csrf)
        return Identity(session.user, self._table.users[session.user].role, address, "cookie", csrf)

    def _holds(self, session: _Session) -> bool:
        now_ns, user = self._clock.now_ns(), self._table.users.get(session.user)
        is_young = now_ns - session.used_ns < SESSION_NS and now_ns - session.begun_ns < LONGEST_SESSION_NS
        return user is not None and is_young and user.changed_utc == session.user_changed_utc

    def _read_file(self) -> None:
        """Take over a change of the file, at most twice a second."""
        now_ns = self._clock.now_ns()
        if now_ns - self._checked_ns < FILE_CHECK_NS:
            return
        self._checked_ns, version = now_ns, self._file.find_version()
        if version == self._version and self._damage is None:
            return
        self._version = version
        try:
            self._table, self._damage = self._file.load(), None
        except Refusal as error:
            self._damage = error


def _lower(one: Role, other: Role) -> Role:
    """The lower of two roles: a token has at most that of its user."""
    return ROLES[min(ROLES.index(one), ROLES.index(other))]


def _derive_csrf(secret: str) -> str:
    """The CSRF token of a session, which is also its name here: the cookie itself is not kept."""
    return sha256(f"csrf {secret}".encode()).hexdigest()
