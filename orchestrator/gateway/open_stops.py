"""Stops by pages that are not signed in, where the fleet file allows it: at a machine whose page hangs on a wall, the
stop must not wait for a password.

`Host` and `Origin` are checked before, as for every request. An e-stop, which has to be released, is for users.
"""

from collections import OrderedDict, deque
from collections.abc import Callable

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.gateway.access.identity import Identity
from orchestrator.gateway.access.sign_in_limits import TooManyTries

STOPS_PER_S = 2  # of one address
MAX_ADDRESSES = 1000  # that are remembered for that
NOT_SIGNED_IN = "(not signed in)"  # in logs; no user can have that name


class OpenStops:
    """Admits stops. is_allowed: what the fleet file says now."""

    def __init__(self, clock: Clock, is_allowed: Callable[[], bool]) -> None:
        self._clock, self.is_allowed = clock, is_allowed
        self._stops: OrderedDict[str, deque[int]] = OrderedDict()

    def admit_stop(self, address: str) -> Identity:
        """The identity of a stop from an address. Raises `TooManyTries`."""
        now_ns = self._clock.now_ns()
        stops = self._stops.setdefault(address, deque(maxlen=STOPS_PER_S))
        self._stops.move_to_end(address)
        if len(self._stops) > MAX_ADDRESSES:
            self._stops.popitem(last=False)
        if len(stops) == STOPS_PER_S and now_ns - stops[0] < NS_PER_S:
            text = f"more than {STOPS_PER_S} stops a second from {address}, which is not signed in"
            raise TooManyTries("too-many-tries", text, "the last stop counts; sign in to stop more often")
        stops.append(now_ns)
        return Identity(NOT_SIGNED_IN, "viewer", address, "open")
