"""Who may move which axes: one holder each, known here, enforced in the adapters, visible on the bus."""

import asyncio
from collections.abc import Callable, Coroutine, Iterable
from dataclasses import dataclass, replace
from typing import Any

from orchestrator.bus.base import Bus, BusError, Declared, Priority, Sample
from orchestrator.bus.keys import Keys
from orchestrator.bus.log import Log
from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.coordinator.fleet.requests import Members
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.motion.targets import Refuse, refuse
from orchestrator.model.fleet import by_controller
from orchestrator.model.messages import LeaseReply, LeaseRequest
from orchestrator.model.report import Lease

ANSWER_S = 2.0
TTL_MS = 3000  # an adapter that hears nothing of a lease for so long takes it back
RENEW_NS = NS_PER_S
LOOK_NS = RENEW_NS // 4


@dataclass(frozen=True, slots=True)
class Held:
    """What one holder has. axes: `controller.axis`. until_ns: when it runs out unless taken again; None: never.

    brief: it ends in a moment; others wait for that instead of being refused. idle: the adapters do not know of it:
    the axes are kept for the holder, who may not move them. taking: grows with each that is taken.
    """

    holder: str
    actor: str
    what: str
    axes: tuple[str, ...]
    until_ns: int | None
    brief: bool = False
    idle: bool = False
    taking: int = 0


class InUse(Refuse):
    """Somebody else has one of the axes."""


class LeaseBook:
    """All leases of the fleet."""

    def __init__(self, view: FleetView, members: Members, clock: Clock, bus: Bus, keys: Keys, log: Log) -> None:
        self._view = view
        self._members = members
        self._clock = clock
        self._bus = bus
        self._keys = keys
        self._log = log
        self._held: dict[str, Held] = {}
        self._given_back = asyncio.Event()
        self._declared: list[Declared] = []
        self._renewing: asyncio.Task[None] | None = None
        self._told_ns: dict[str, int] = {}  # by holder: when the adapters were told of it last
        self._tasks: set[asyncio.Task[None]] = set()
        self._takings = 0
        self._listeners: list[Callable[[str], None]] = []

    async def start(self) -> None:
        """Begin to renew what is held, and to say who holds what to those who ask."""
        self._renewing = asyncio.get_running_loop().create_task(self._renew())
        for controller in self._view.fleet.controllers:
            self._declared.append(await self._bus.serve(self._keys.lease(controller), self._answer))

    async def close(self) -> None:
        if self._renewing is not None:
            self._renewing.cancel()
        for declared in self._declared:
            await declared.undeclare()
        self._declared.clear()

    async def _answer(self, sample: Sample) -> bytes:
        """The lease of a controller; where its axes are held by several, that of the first."""
        controller = sample.key.rpartition("/")[2]
        mine = [held for held in self._held.values() if controller in by_controller(held.axes)]
        lease = self._lease(mine[0], controller, None, mine[0].holder) if mine else self._free(controller)
        return lease.to_json()

    @property
    def held(self) -> tuple[Held, ...]:
        """All leases, by holder."""
        return tuple(self._held.values())

    def listen(self, listener: Callable[[str], None]) -> None:
        """Call `listener` with the holder whenever axes have been given back."""
        self._listeners.append(listener)

    def may_move(self, holder: str) -> bool:
        """Whether `holder` has axes, and the adapters know of it."""
        held = self._held.get(holder)
        return held is not None and not held.idle

    def conflict(self, axes: Iterable[str], holder: str = "") -> Held | None:
        """Who else than `holder` has one of `axes`."""
        wanted = set(axes)
        return next((held for held in self._held.values() if held.holder != holder and wanted & set(held.axes)), None)

    def restore(self, held: Held) -> None:
        """Go on with what an earlier coordinator had given, as far as nobody may move by it."""
        self._held[held.holder] = replace(held, idle=True)
        self._publish(held, held.holder)

    async def suspend(self, holder: str, reason: str) -> None:
        """Keep the axes for `holder`, who may not move them any more; what moves is stopped by the adapters."""
        held = self._held.get(holder)
        if held is None or held.idle:
            return
        self._held[holder] = replace(held, idle=True)
        self._log.warning(f"{held.actor} ({held.what}) may not move axes any more: {reason}", holder=holder)
        try:
            await self._tell(held, 0, reason)
        except Refuse as error:
            self._log.warning(f"lease not taken back: {error.refusal.text}; it runs out by itself", holder=holder)

    async def take(
        self,
        holder: str,
        actor: str,
        what: str,
        axes: Iterable[str],
        ttl_ns: int | None = None,
        brief: bool = False,
        idle: bool = False,
    ) -> tuple[str, ...]:
        """Take `axes` for `holder`, or go on holding them; gives all that are held by it for that: whole controllers
        where axes can not be told apart. Raises `InUse`, `Refuse`; then nothing is held that was not before."""
        whole = await self._whole(axes)
        while (other := self.conflict(whole, holder)) is not None and other.brief:
            self._given_back.clear()
            await self._given_back.wait()
        if other is not None:
            theirs = next(axis for axis in whole if axis in other.axes)
            raise InUse(
                "leased",
                f"{theirs} is in use by {other.actor} ({other.what})",
                "wait for its end, or ask them",
                theirs.partition(".")[0],
            )
        before = self._held.get(holder)
        mine = tuple(dict.fromkeys((*(before.axes if before else ()), *whole)))
        until_ns = None if ttl_ns is None else self._clock.now_ns() + ttl_ns
        # Held from here on: nobody else may take them while the adapters are asked.
        idle = idle or (before is not None and before.idle)
        self._takings += before is None
        taking = self._takings if before is None else before.taking
        held = self._held[holder] = Held(holder, actor, what, mine, until_ns, brief, idle, taking)
        if before is None or set(mine) != set(before.axes):
            try:
                if not idle:
                    await self._tell(held, TTL_MS)
            except Refuse:
                await self.give_back(holder)
                raise
            if self._held.get(holder) is not held:
                raise Refuse("not-leased", "the lease ended while it was being given")
            self._publish(held, holder)
        return whole

    async def give_back(self, holder: str, reason: str = "") -> None:
        """End what `holder` has; what it still moves is stopped by the adapters."""
        held = self._held.get(holder)
        if held is None:
            return
        # Whoever wants the axes now waits for the adapters to let them go.
        self._held[holder] = replace(held, brief=True)
        if reason:
            self._log.warning(f"the lease of {held.actor} ({held.what}) ends: {reason}", holder=holder)
        try:
            if not held.idle:
                await self._tell(held, 0, reason)
        except Refuse as error:
            self._log.warning(f"lease not taken back: {error.refusal.text}; it runs out by itself", holder=holder)
        self._held.pop(holder, None)
        self._told_ns.pop(holder, None)
        self._given_back.set()
        self._publish(held, None)
        for listener in self._listeners:
            listener(holder)

    async def _whole(self, axes: Iterable[str]) -> tuple[str, ...]:
        """`axes`, and with them all of the controllers whose axes can only be held together. Raises `Refuse`."""
        whole: list[str] = []
        for controller, names in by_controller(axes).items():
            try:
                info = await self._view.info(controller)
            except BusError as error:
                raise Refuse("absent", f"{controller}: {error}", "is its adapter host running?", controller) from None
            digest = self._view.fleet.controllers[controller].digest
            if info.digest != digest:
                raise Refuse(
                    "other-configuration",
                    f"{controller}: the coordinator believes in configuration {digest}, the adapter has {info.digest}",
                    "use one fleet file on all hosts and restart",
                    controller,
                )
            all_names = self._view.fleet.controllers[controller].axes
            whole += [f"{controller}.{name}" for name in (names if info.independent_axes else all_names)]
        return tuple(whole)

    async def _tell(self, held: Held, ttl_ms: int, reason: str = "") -> None:
        """Tell the adapters. Raises `Refuse` for the first that refuses."""

        asked_ns = self._told_ns[held.holder] = self._clock.now_ns()
        requests = {
            controller: LeaseRequest(
                **self._members.fields(held.actor),
                axes=names,
                holder=held.holder,
                taking=held.taking,
                ttl_ms=ttl_ms,
                reason=reason,
            )
            for controller, names in by_controller(held.axes).items()
        }
        replies = await self._members.ask_all("lease", requests, LeaseReply, ANSWER_S)
        for reply in replies.values():
            if reply.refused is not None:
                raise refuse(reply.refused)
            if reply.state is not None:
                self._view.answered(reply.state, asked_ns)

    async def _renew(self) -> None:
        """Each lease when its own time has come: a job that has just been given one is about to load all its members,
        and renewals for sixteen take their processors a twentieth of a second."""
        while True:
            await sleep_ns(self._clock, LOOK_NS)
            now_ns = self._clock.now_ns()
            # One that does not answer must not keep the others' leases from being renewed in time.
            for held in self._held.values():
                if held.brief:
                    continue
                if held.until_ns is not None and held.until_ns <= now_ns:
                    self._spawn(self.give_back(held.holder, "it was not renewed"))
                elif not held.idle and now_ns - self._told_ns.get(held.holder, 0) >= RENEW_NS:
                    self._spawn(self._renew_one(held))

    def _spawn(self, coroutine: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _renew_one(self, held: Held) -> None:
        try:
            await self._tell(held, TTL_MS)
        except Refuse as error:
            self._log.warning(f"lease not renewed: {error.refusal.text}", holder=held.holder)

    def _publish(self, held: Held, holder: str | None) -> None:
        for controller, names in by_controller(held.axes).items():
            whole = set(names) == set(self._view.fleet.controllers[controller].axes)
            for axis in [None] if whole else names:
                lease = self._lease(held, controller, axis, holder)
                self._bus.put(self._keys.lease(controller, axis), lease.to_json(), Priority.EVENT)

    def _lease(self, held: Held, controller: str, axis: str | None, holder: str | None) -> Lease:
        return Lease(
            controller=controller,
            axis=axis,
            holder=holder,
            actor=held.actor,
            what=held.what,
            epoch=self._members.throne.epoch,
        )

    def _free(self, controller: str) -> Lease:
        return Lease(controller=controller, holder=None, actor="", epoch=self._members.throne.epoch)
