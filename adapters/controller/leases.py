"""Who may move the axes of a controller: one holder each, in the reign that gave it, for as long as it is renewed."""

from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from adapters.contract import CannotDo
from orchestrator.clock.base import NS_PER_MS, Clock, Timer
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import LeaseRequest

ENDS_KEPT = 64  # holders


@dataclass(frozen=True, slots=True)
class _Lease:
    holder: str
    actor: str
    until_ns: int


@dataclass(frozen=True, slots=True)
class _Ended:
    """Why the lease of a holder has ended; final: it was taken back, and no late renewal may revive it, up to that of
    the number `taking`; None: it was not taken back."""

    reason: str
    taking: int | None


class Leases:
    """The leases of one controller. `ended(holder, axes, reason)` is called when axes are no longer held.

    Where the axes can not be moved independently of each other, only all of them together can be held.
    """

    def __init__(
        self,
        config: Controller,
        clock: Clock,
        independent_axes: Callable[[], bool],
        ended: Callable[[str, list[str], str], None],
    ) -> None:
        self._config = config
        self._clock = clock
        self._independent_axes = independent_axes
        self._ended = ended
        self._held: dict[str, _Lease] = {}
        self._ends: OrderedDict[str, _Ended] = OrderedDict()
        self._timer: Timer | None = None

    @property
    def holders(self) -> dict[str, str]:
        """Holder by axis, for axes that are held."""
        return {axis: lease.holder for axis, lease in self._held.items()}

    def grant(self, request: LeaseRequest) -> None:
        """Give, renew or (`ttl_ms` 0) take back. Raises `CannotDo`; then nothing has changed."""
        if not self._independent_axes() and set(request.axes) != set(self._config.axes):
            raise CannotDo(
                "whole-controller",
                "the axes of this controller can not be moved independently of each other",
                f"take all of them: {', '.join(self._config.axes)}",
            )
        if request.ttl_ms == 0:
            mine = [axis for axis in request.axes if self._holds(request.holder, axis)]
            self._end(mine, request.reason or "given back")
            self._note_end(request.holder, request.reason or "given back", request.taking)
            return
        ended = self._ends.get(request.holder)
        if ended is not None and ended.taking is not None and request.taking <= ended.taking:
            raise CannotDo("lease-over", f"the lease of {request.holder} is over", "take it under a new name")
        for axis in request.axes:
            lease = self._held.get(axis)
            if lease is not None and lease.holder != request.holder:
                raise CannotDo("leased", f"axis {axis} is held by {lease.actor} ({lease.holder})", "wait, or ask them")
        until_ns = self._clock.now_ns() + request.ttl_ms * NS_PER_MS
        for axis in request.axes:
            self._held[axis] = _Lease(request.holder, request.actor, until_ns)
        self._look()

    def require(self, holder: str, axes: Iterable[str]) -> None:
        """Raises `CannotDo` unless `holder` holds all `axes`."""
        for axis in axes:
            lease = self._held.get(axis)
            if lease is None:
                ended = self._ends.get(holder)
                why = f"; its lease has ended: {ended.reason}" if ended is not None else ""
                raise CannotDo("not-leased", f"axis {axis} is not held by {holder}{why}", "take it first")
            if lease.holder != holder:
                raise CannotDo("leased", f"axis {axis} is held by {lease.actor} ({lease.holder})", "wait, or ask them")

    def drop(self, reason: str) -> None:
        """End all leases: another reign has begun, which counts anew, or nobody reigns."""
        self._ends = OrderedDict((holder, _Ended(each.reason, None)) for holder, each in self._ends.items())
        self._end(list(self._held), reason)

    def _holds(self, holder: str, axis: str) -> bool:
        lease = self._held.get(axis)
        return lease is not None and lease.holder == holder

    def _look(self) -> None:
        """End what has run out, and look again when the next one will have."""
        now_ns = self._clock.now_ns()
        self._end([axis for axis, lease in self._held.items() if lease.until_ns <= now_ns], "the lease has run out")
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._held:
            first_ns = min(lease.until_ns for lease in self._held.values())
            self._timer = self._clock.call_at_ns(first_ns, self._look)

    def _end(self, axes: list[str], reason: str) -> None:
        by_holder: dict[str, list[str]] = {}
        for axis in axes:
            by_holder.setdefault(self._held.pop(axis).holder, []).append(axis)
        for holder, lost in by_holder.items():
            self._note_end(holder, reason, None)
            self._ended(holder, lost, reason)

    def _note_end(self, holder: str, reason: str, taking: int | None) -> None:
        self._ends[holder] = _Ended(reason, taking)
        if len(self._ends) > ENDS_KEPT:
            self._ends.popitem(last=False)
