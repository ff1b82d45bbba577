"""The limit of failed sign-ins. They count by user and address together, so that wrong passwords from elsewhere keep no
user out; a browser that the user has signed in with before has a count of its own, also where all have one address.
"""

import ipaddress
from collections import Counter, OrderedDict
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.model.errors import Refusal

FREE_FAILURES = 5  # failed sign-ins that cost no time
FIRST_PAUSE_NS, LONGEST_PAUSE_NS = NS_PER_S, 300 * NS_PER_S
FORGET_NS = 900 * NS_PER_S  # after which one failure is forgotten
MAX_FAILED = 10_000  # users with addresses or browsers whose failures are counted
MAX_VERIFYING = 8  # passwords that wait for verification: each takes a tenth of a second
MAX_UNKNOWN_VERIFYING, MAX_ADDRESS_VERIFYING = 6, 2  # of those, from browsers that are not known; of one address


class TooManyTries(Refusal):
    """Too many sign-ins have failed. HTTP status 429."""


@dataclass(frozen=True, slots=True)
class SignInSource:
    """Where a sign-in comes from. browser: the id of one that its user has signed in with before; else empty."""

    address: str
    browser: str = ""

    @property
    def name(self) -> str:
        """What failures are counted by. Of IPv6 a computer has a whole network (RFC 6177)."""
        if self.browser:
            return f"browser {self.browser}"
        try:
            address = ipaddress.ip_address(self.address)
        except ValueError:
            return self.address
        network = ipaddress.ip_network(f"{address}/64", strict=False) if address.version == 6 else address
        return str(network)


@dataclass(slots=True)
class _Failures:
    count: float = 0.0
    at_ns: int = 0
    wait_until_ns: int = 0


class SignInLimits:
    """Counts failures, and the passwords that are verified."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._failures: OrderedDict[tuple[str, str], _Failures] = OrderedDict()
        self._verifying: Counter[str] = Counter()

    def require_pause(self, user: str, source: SignInSource) -> None:
        """Raises `TooManyTries` before the end of a pause."""
        failures, now_ns = self._failures.get((user[:64], source.name)), self._clock.now_ns()
        if failures is not None and failures.wait_until_ns > now_ns:
            seconds = -(-(failures.wait_until_ns - now_ns) // NS_PER_S)
            text = f"too many sign-ins of this user have failed here; wait {seconds} s"
            raise TooManyTries("too-many-tries", text, "then try again, or use a browser that you have signed in with")

    @contextmanager
    def verify(self, source: SignInSource) -> Generator[None]:
        """Take a place for the time of a verification. Raises `TooManyTries`."""
        name = source.name
        unknown_count = sum(count for key, count in self._verifying.items() if not key.startswith("browser "))
        is_full = self._verifying.total() >= MAX_VERIFYING or self._verifying[name] >= MAX_ADDRESS_VERIFYING
        if is_full or (not source.browser and unknown_count >= MAX_UNKNOWN_VERIFYING):
            raise TooManyTries("too-many-tries", "too many sign-ins at once", "try again in a second")
        self._verifying[name] += 1
        try:
            yield
        finally:
            self._verifying[name] -= 1
            self._verifying += Counter()  # without those that are 0

    def count_failure(self, user: str, source: SignInSource) -> None:
        """Count a wrong password; after some, the next one costs a pause."""
        key, now_ns = (user[:64], source.name), self._clock.now_ns()
        failures = self._failures.setdefault(key, _Failures(at_ns=now_ns))
        self._failures.move_to_end(key)
        failures.count = max(0.0, failures.count - (now_ns - failures.at_ns) / FORGET_NS) + 1.0
        failures.at_ns = now_ns
        over = round(failures.count) - FREE_FAILURES
        if over >= 0:
            failures.wait_until_ns = now_ns + min(FIRST_PAUSE_NS << min(over, 20), LONGEST_PAUSE_NS)
        while len(self._failures) > MAX_FAILED:
            self._failures.popitem(last=False)

    def forget_failures(self, user: str, source: SignInSource) -> None:
        """After a right password."""
        self._failures.pop((user[:64], source.name), None)
