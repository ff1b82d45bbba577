"""Leases: the right to move axes. One holder each, kept here, enforced in the adapters, published on the bus."""

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from orchestrator.bus.base import Bus, BusDeclaration, BusError, BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.owner import wait_for_first
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.lease_states import LeaseHold, LeaseStates, LeaseUser, ServedLeases
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet, group_by_controller
from orchestrator.model.messages import JogRoom, LeaseReply, LeaseRequest, PairLease
from orchestrator.model.names import controller_of
from orchestrator.model.units import convert_units

ANSWER_S = 2.0
TRIES = 2  # within it, to acquire a lease; a renewal is followed by the next one anyhow
TTL_MS = 3000  # an adapter ends a lease that is not renewed for this long
GIVE_BACK_NS = 10 * NS_PER_S  # for a brief lease to end: its holder waits for an answer of an adapter, twice at most
RENEW_NS = NS_PER_S
RENEW_POLL_NS = RENEW_NS // 4


RoomFinder = Callable[[Sequence[str], Mapping[str, JogRoom], str], Awaitable[Mapping[str, JogRoom]]]
"""Finds where axes are jogged under the lease of a holder, beside the rooms that some of them have already."""


async def _find_no_rooms(axes: Sequence[str], rooms: Mapping[str, JogRoom], holder: str) -> Mapping[str, JogRoom]:
    del axes, rooms, holder
    return {}


class AxesInUse(Refusal):
    """Another holder has one of the axes."""


class LeaseRegistry:
    """All leases of the fleet."""

    def __init__(self, fleet: FleetAccess, bus: Bus, keys: FleetKeys) -> None:
        self._fleet = fleet
        self._bus = bus
        self._keys = keys
        self._states = LeaseStates(fleet, bus, keys)
        self._held: dict[str, LeaseHold] = {}
        self._given_back = asyncio.Event()
        self._declared: list[BusDeclaration] = []
        self._renewing: asyncio.Task[None] | None = None
        self._told_ns: dict[str, int] = {}  # by holder: when it was last sent to the adapters
        self._takings = 0
        self._listeners: list[Callable[[str], None]] = []
        self.find_rooms: RoomFinder = _find_no_rooms
        """Finds where axes are jogged under manual control; it is called once no other holder has them."""

    async def start(self) -> None:
        """Begin to renew leases, and to answer queries for them."""
        self._renewing = self._fleet.tasks.spawn(self._renew_leases(), vital=True)
        served_leases = ServedLeases(self._keys, lambda: self._fleet.view.fleet.controllers, self._reply_lease)
        self._declared.append(await self._bus.serve_group(self._keys.controller_leases, served_leases))

    async def close(self) -> None:
        if self._renewing is not None:
            self._renewing.cancel()
        for declaration in self._declared:
            await declaration.undeclare()
        self._declared.clear()

    async def _reply_lease(self, sample: BusSample) -> bytes:
        """Return the lease of a controller; where several holders have its axes, that of the first."""
        controller = sample.key.rpartition("/")[2]
        own_holds = [hold for hold in self._held.values() if controller in map(controller_of, hold.axes)]
        lease = (
            self._states.make_state(own_holds[0], controller, None, own_holds[0].holder)
            if own_holds
            else self._states.make_free_state(controller)
        )
        return lease.to_json()

    @property
    def all_leases(self) -> tuple[LeaseHold, ...]:
        """All leases, by holder."""
        return tuple(self._held.values())

    def add_release_listener(self, listener: Callable[[str], None]) -> None:
        """Call `listener` with the holder whenever axes have been released."""
        self._listeners.append(listener)

    def may_move(self, holder: str) -> bool:
        """Whether `holder` has a lease that the adapters have, too."""
        hold = self._held.get(holder)
        return hold is not None and not hold.idle

    def find_conflict(self, axes: Iterable[str], holder: str = "") -> LeaseHold | None:
        """The lease of another holder on one of `axes`."""
        wanted_axes = set(axes)
        return next(
            (hold for hold in self._held.values() if hold.holder != holder and wanted_axes & set(hold.axes)),
            None,
        )

    def find_lease(self, holder: str) -> LeaseHold | None:
        """The lease of a holder."""
        return self._held.get(holder)

    def find_owner(self, axis: str) -> str | None:
        """The holder of the lease of an axis, also of one that its adapter has not got yet; None: it has none."""
        return next((hold.holder for hold in self._held.values() if axis in hold.axes), None)

    def set_rooms(self, hold: LeaseHold, rooms: Mapping[str, JogRoom]) -> LeaseHold:
        """Note other rooms of a lease, for its next renewals; return the lease with them."""
        self._held[hold.holder] = replace(hold, rooms=rooms)
        return self._held[hold.holder]

    def describe_use(self, held: LeaseHold) -> str:
        """A description of a lease for others that need its axes: by which user, what for, until when."""
        end = self._states.find_end_utc(held)
        end_text = "" if end is None else f", until {end[:19]}Z"
        return f"in use by {held.actor} ({held.what}{end_text})"

    def restore_reservation(self, held: LeaseHold) -> None:
        """Restore a reservation of an earlier coordinator, without the right to move."""
        self._held[held.holder] = replace(held, idle=True)
        self._states.publish(held, held.holder)

    async def suspend_motion(self, holder: str, reason: str) -> None:
        """Keep the axes reserved for `holder` without the right to move them; the adapters stop motion."""
        hold = self._held.get(holder)
        if hold is None or hold.idle:
            return
        self._held[holder] = replace(hold, idle=True)
        self._fleet.log.warning(f"{hold.actor} ({hold.what}) may no longer move axes: {reason}", holder=holder)
        try:
            await self.send_lease(hold, 0, reason)
        except Refusal as error:
            self._fleet.log.warning(f"lease not ended: {error.text}; it expires by itself", holder=holder)

    async def acquire(
        self,
        user: LeaseUser,
        axes: Iterable[str],
        ttl_ns: int | None = None,
        *,
        brief: bool = False,
        idle: bool = False,
    ) -> tuple[str, ...]:
        """Acquire `axes` for `user`, or renew its lease; return all axes of that lease: whole controllers where
        axes cannot be leased separately. ttl_ns: of manual control, under which axes are jogged. Raises `InUse`,
        `Refusal`; then no new lease has been made."""
        holder = user.holder
        all_axes = await _complete_controllers(self._fleet.view, axes)
        other_hold = await self._wait_for_release(all_axes, holder)
        if other_hold is not None:
            theirs = next(axis for axis in all_axes if axis in other_hold.axes)
            raise AxesInUse(
                "leased",
                f"{theirs} is {self.describe_use(other_hold)}",
                "wait for the end of that use, or contact its holder",
                controller_of(theirs),
            )
        hold_before = self._held.get(holder)
        own_axes = tuple(dict.fromkeys((*(hold_before.axes if hold_before else ()), *all_axes)))
        until_ns = None if ttl_ns is None else self._fleet.clock.now_ns() + ttl_ns
        # The lease counts from here on: no other holder can acquire the axes while the adapters are queried.
        self._takings += hold_before is None
        hold = LeaseHold(holder, user.actor, user.what, own_axes, until_ns, brief, idle, self._takings, user.session)
        hold = self._held[holder] = hold if hold_before is None else hold.renew(hold_before)
        is_new = hold_before is None or set(own_axes) != set(hold_before.axes) or hold.lacks_rooms
        if is_new:
            try:
                if ttl_ns is not None:
                    hold = await self._add_rooms(hold)
                if not hold.idle:
                    await self.send_lease(hold, TTL_MS, tries=TRIES)
            except Refusal:
                await self.release(holder)
                raise
            if self._held.get(holder) is not hold:
                raise Refusal("not-leased", "the lease ended while it was being acquired")
            self._states.publish(hold, holder)
        return all_axes

    async def _add_rooms(self, hold: LeaseHold) -> LeaseHold:
        """The lease with the rooms of its axes. Raises `Refusal` where it has ended meanwhile."""
        rooms = await self.find_rooms(hold.axes, hold.rooms or {}, hold.holder)
        if self._held.get(hold.holder) is not hold:
            raise Refusal("not-leased", "the lease ended while it was being acquired")
        return self.set_rooms(hold, rooms)

    async def _wait_for_release(self, axes: Iterable[str], holder: str) -> LeaseHold | None:
        """Wait for the end of another holder's brief lease on `axes`; return the lease that is still in the way."""
        until_ns = self._fleet.clock.now_ns() + GIVE_BACK_NS
        while (other_hold := self.find_conflict(axes, holder)) is not None and other_hold.brief:
            left_ns = until_ns - self._fleet.clock.now_ns()
            if left_ns <= 0:
                self._fleet.log.warning(f"waited in vain for the end of the lease of {other_hold.actor}", holder=holder)
                return other_hold
            self._given_back.clear()
            await wait_for_first(self._given_back.wait(), sleep_ns(self._fleet.clock, left_ns))
        return other_hold

    async def release(self, holder: str, reason: str = "") -> None:
        """End the lease of `holder`; the adapters stop what it still moves."""
        hold = self._held.get(holder)
        if hold is None:
            return
        # A request that needs the axes now waits for the adapters to end the lease.
        self._held[holder] = replace(hold, brief=True)
        if reason:
            self._fleet.log.warning(f"the lease of {hold.actor} ({hold.what}) ends: {reason}", holder=holder)
        try:
            if not hold.idle:
                await self.send_lease(hold, 0, reason)
        except Refusal as error:
            self._fleet.log.warning(f"lease not ended: {error.text}; it expires by itself", holder=holder)
        finally:
            # Also when the request behind it is cancelled: it is not renewed any more, and the adapters end it.
            self._held.pop(holder, None)
            self._told_ns.pop(holder, None)
            self._given_back.set()
            self._states.publish(hold, None)
            for listener in self._listeners:
                listener(holder)

    async def send_lease(self, held: LeaseHold, ttl_ms: int, reason: str = "", tries: int = 1) -> list[str]:
        """Send a lease to the adapters; return the axes that keep another room. Raises `Refusal` for the first that
        refuses.

        tries: a request that is lost in a gap of the bus is sent again; it keeps its id, so it counts once.
        """
        asked_ns = self._told_ns[held.holder] = self._fleet.clock.now_ns()
        requests = {
            controller: LeaseRequest(
                **self._fleet.requests.request_fields(held.actor),
                axes=names,
                pairs=_find_pairs(self._fleet.view.fleet, controller, names),
                rooms={name: room for name in names if (room := held.find_room(f"{controller}.{name}")) is not None},
                holder=held.holder,
                acquisition=held.acquisition,
                session=held.session,
                ttl_ms=ttl_ms,
                reason=reason,
            )
            for controller, names in group_by_controller(held.axes).items()
        }
        replies: dict[str, LeaseReply] = {}
        for _ in range(tries):
            open_requests = {name: request for name, request in requests.items() if _is_unanswered(replies.get(name))}
            if open_requests:
                replies |= await self._fleet.requests.request_all("lease", open_requests, LeaseReply, ANSWER_S / tries)
        for reply in replies.values():
            if reply.refused is not None:
                raise reply.refused.as_step_error()
            if reply.state is not None:
                self._fleet.view.note_answer(reply.state, asked_ns)
        return [f"{controller}.{axis}" for controller, reply in replies.items() for axis in reply.kept]

    async def _renew_leases(self) -> None:
        """Renew each lease at its own time: a job that has just acquired one is about to load all its members, and
        renewing sixteen at that moment occupies their processors for a twentieth of a second."""
        while True:
            await sleep_ns(self._fleet.clock, RENEW_POLL_NS)
            now_ns = self._fleet.clock.now_ns()
            # One adapter that does not answer must not delay the renewal of other leases.
            for hold in self._held.values():
                if hold.brief or hold.lacks_rooms:
                    continue
                if hold.until_ns is not None and hold.until_ns <= now_ns:
                    self._fleet.tasks.spawn(self.release(hold.holder, "it was not renewed"), vital=False)
                elif not hold.idle and now_ns - self._told_ns.get(hold.holder, 0) >= RENEW_NS:
                    self._fleet.tasks.spawn(self._renew_one(hold), vital=False)

    async def _renew_one(self, held: LeaseHold) -> None:
        try:
            async with held.sending:
                hold = self._held.get(held.holder)  # its rooms may have changed while this waited
                if hold is not None and not hold.brief:
                    await self.send_lease(hold, TTL_MS)
        except Refusal as error:
            self._fleet.log.warning(f"lease not renewed: {error.text}", holder=held.holder)


def _is_unanswered(reply: LeaseReply | None) -> bool:
    return reply is None or (reply.refused is not None and reply.refused.code == "no-answer")


def _find_pairs(fleet: Fleet, controller: str, names: Iterable[str]) -> dict[str, PairLease]:
    """How those of the axes of a controller are jogged that are one of a pair."""
    pairs: dict[str, PairLease] = {}
    for name in names:
        pair = fleet.virtual_axes.pair_of.get(f"{controller}.{name}")
        if pair is not None:
            reach = convert_units(pair.jog_reach, pair.unit, fleet.axis(f"{controller}.{name}").unit, name)
            pairs[name] = PairLease(by=pair.middle, reach=float(reach))
    return pairs


async def _complete_controllers(view: FleetView, axes: Iterable[str]) -> tuple[str, ...]:
    """Extend `axes` to all axes of the controllers whose axes can only be leased together. Raises `Refusal`."""
    all_axes: list[str] = []
    groups = group_by_controller(axes)
    await view.infos.prefetch(groups)
    for controller, names in groups.items():
        try:
            info = await view.infos.query(controller)
        except BusError as error:
            raise view.make_absence(controller, str(error)) from None
        digest = view.fleet.controllers[controller].digest
        if info.digest != digest:
            raise Refusal(
                "other-configuration",
                f"{controller}: the coordinator uses configuration {digest}, the adapter uses {info.digest}",
                "use one fleet file on all hosts and restart",
                controller,
            )
        all_names = view.fleet.controllers[controller].axes
        all_axes += [f"{controller}.{name}" for name in (names if info.independent_axes else all_names)]
    return tuple(all_axes)
