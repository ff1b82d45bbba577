"""Motion leases of the axes of a controller: one holder per axis, granted under one leader, valid as long as it is
renewed."""

from collections import OrderedDict
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass

from adapters.controller.state.context import ControllerContext
from orchestrator.clock.base import NS_PER_MS, ClockTimer
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import JogRoom, LeaseRequest, PairLease
from orchestrator.model.names import controller_of

HOLDERS_REMEMBERED = 64  # holders
_EVER = 2**53  # above the number of any acquisition


@dataclass(frozen=True, slots=True)
class _AxisLease:
    """session, since_ns: the session that it ends with (empty: none), and when it was granted first. pair: how it is
    jogged, if it is one of a pair. room: where it is jogged, if it moves bodies of zones."""

    holder: str
    actor: str
    until_ns: int
    session: str
    since_ns: int
    pair: PairLease | None
    room: JogRoom | None


@dataclass(frozen=True, slots=True)
class _LeaseEnd:
    """Why the lease of a holder has ended.

    taking: the lease was released with this number, which is final: no late renewal up to this number may revive it.
    None: it was not released."""

    reason: str
    taking: int | None


class MotionLeases:
    """The leases of one controller. `on_ended(holder, axes, reason)` is called when axes are no longer leased; it is
    set before the first request.

    The leases of a session end when it no longer counts as present, see `SessionSigns.present_until_ns`. If the axes
    cannot be moved independently of each other, only all of them together can be leased.
    """

    on_ended: Callable[[str, list[str], str], None]

    def __init__(self, context: ControllerContext) -> None:
        self._config = context.config
        self._clock = context.clock
        self._driver = context.driver
        self._sessions = context.sessions
        self._leases: dict[str, _AxisLease] = {}
        self._lease_ends: OrderedDict[str, _LeaseEnd] = OrderedDict()
        self._timer: ClockTimer | None = None
        self.is_jogging: Callable[[str], bool] = lambda axis: False
        """Whether an axis is being jogged."""

    @property
    def holders(self) -> dict[str, str]:
        """Holder by axis, for axes that are leased."""
        return {axis: lease.holder for axis, lease in self._leases.items()}

    def apply_request(self, request: LeaseRequest) -> list[str]:
        """Grant, renew or (`ttl_ms` 0) release a lease; return the axes that are being jogged, and keep another room:
        its end was given to their controller. Raises `Refusal`; then nothing has changed."""
        if not self._driver.capabilities.independent_axes and set(request.axes) != set(self._config.axes):
            raise Refusal(
                "whole-controller",
                "the axes of this controller cannot be moved independently of each other",
                f"lease all of them: {', '.join(self._config.axes)}",
            )
        if request.ttl_ms == 0:
            own_axes = [axis for axis in request.axes if self._is_holder(request.holder, axis)]
            self._end_leases(own_axes, request.reason or "the lease was released")
            self._record_end(request.holder, request.reason or "the lease was released", request.acquisition)
            return []
        lease_end = self._lease_ends.get(request.holder)
        if lease_end is not None and lease_end.taking is not None and request.acquisition <= lease_end.taking:
            raise Refusal("lease-over", f"the lease of {request.holder} is over", "acquire it under a new name")
        for axis in request.axes:
            lease = self._leases.get(axis)
            if lease is not None and lease.holder != request.holder:
                raise Refusal(
                    "leased", f"axis {axis} is leased to {lease.actor} ({lease.holder})", "wait, or have it released"
                )
        kept_axes = self._grant_axes(request)
        self._expire_leases()
        return kept_axes

    def _grant_axes(self, request: LeaseRequest) -> list[str]:
        kept_axes = [axis for axis in request.axes if self._keeps_room(axis, request.rooms.get(axis))]
        for axis in request.axes:
            self._grant_axis(axis, request, keeps_room=axis in kept_axes)
        return kept_axes

    def _keeps_room(self, axis: str, room: JogRoom | None) -> bool:
        lease = self._leases.get(axis)
        return lease is not None and lease.room != room and self.is_jogging(axis)

    def _grant_axis(self, axis: str, request: LeaseRequest, *, keeps_room: bool) -> None:
        now_ns, lease = self._clock.now_ns(), self._leases.get(axis)
        self._leases[axis] = _AxisLease(
            holder=request.holder,
            actor=request.actor,
            until_ns=now_ns + request.ttl_ms * NS_PER_MS,
            session=request.session,
            since_ns=now_ns if lease is None else lease.since_ns,
            pair=request.pairs.get(axis),
            room=lease.room if lease is not None and keeps_room else request.rooms.get(axis),
        )

    def require_lease(self, holder: str, axes: Iterable[str]) -> None:
        """Raise `Refusal` unless `holder` has the lease of all `axes`."""
        for axis in axes:
            lease = self._leases.get(axis)
            if lease is None:
                lease_end = self._lease_ends.get(holder)
                end_text = f"; its lease has ended: {lease_end.reason}" if lease_end is not None else ""
                raise Refusal(
                    "not-leased", f"axis {axis} is not leased to {holder}{end_text}", "acquire the lease first"
                )
            if lease.holder != holder:
                raise Refusal(
                    "leased", f"axis {axis} is leased to {lease.actor} ({lease.holder})", "wait, or have it released"
                )

    def require_groups(self, velocities: Mapping[str, float], groups: Collection[str]) -> None:
        """Raise `Refusal` for a jog of one axis of a pair by itself. groups: of virtual axes that the jog moves."""
        for axis, velocity in velocities.items():
            pair = self._leases[axis].pair if velocity and axis in self._leases else None
            if pair is not None and controller_of(pair.by) not in groups:
                text = f"axis {axis} is one of the pair {controller_of(pair.by)}, and does not move alone"
                raise Refusal("pair", text, f"jog {pair.by}, which moves both")

    def find_reach(self, axis: str) -> float | None:
        """How far one jog of an axis goes, in its unit; None: to its soft limits."""
        lease = self._leases.get(axis)
        return None if lease is None or lease.pair is None else lease.pair.reach

    def find_room(self, axis: str) -> JogRoom | None:
        """Where an axis is jogged; None: it moves no bodies of zones."""
        lease = self._leases.get(axis)
        return None if lease is None else lease.room

    def end_all(self, reason: str) -> None:
        """End all leases: there is a new leader, which numbers its leases from the beginning, or none."""
        self._lease_ends = OrderedDict(
            (holder, _LeaseEnd(lease_end.reason, None)) for holder, lease_end in self._lease_ends.items()
        )
        self._end_leases(list(self._leases), reason)

    def _is_holder(self, holder: str, axis: str) -> bool:
        lease = self._leases.get(axis)
        return lease is not None and lease.holder == holder

    def _expire_leases(self) -> None:
        """End expired leases and set the timer for the next expiry."""
        now_ns = self._clock.now_ns()
        of_sessions = {axis: lease for axis, lease in self._leases.items() if lease.session}
        absent = [axis for axis, lease in of_sessions.items() if self._present_until_ns(lease) <= now_ns]
        self._end_leases(absent, "the command that it belongs to has ended", final=True)
        self._end_leases(
            [axis for axis, lease in self._leases.items() if lease.until_ns <= now_ns], "the lease has expired"
        )
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._leases:
            first_ns = min(min(lease.until_ns, self._present_until_ns(lease)) for lease in self._leases.values())
            self._timer = self._clock.call_at_ns(first_ns, self._expire_leases)

    def _present_until_ns(self, lease: _AxisLease) -> int:
        """Until when the lease is valid without another sign of life of its session."""
        return self._sessions.present_until_ns(lease.session, lease.since_ns) if lease.session else lease.until_ns

    def _end_leases(self, axes: list[str], reason: str, *, final: bool = False) -> None:
        """End the leases of `axes`. final: no renewal under way may revive them."""
        by_holder: dict[str, list[str]] = {}
        for axis in axes:
            by_holder.setdefault(self._leases.pop(axis).holder, []).append(axis)
        for holder, lost_axes in by_holder.items():
            self._record_end(holder, reason, _EVER if final else None)
            self.on_ended(holder, lost_axes, reason)

    def _record_end(self, holder: str, reason: str, taking: int | None) -> None:
        self._lease_ends[holder] = _LeaseEnd(reason, taking)
        if len(self._lease_ends) > HOLDERS_REMEMBERED:
            self._lease_ends.popitem(last=False)
