"""Manual control: axes acquired, jogged, released.

async with tutti.manual_control(["gantry.x"], what="alignment") as manual:
    await manual.jog({"gantry.x": 5.0})     # mm/s, for 200 ms
    for _ in range(10):
        await asyncio.sleep(0.05)
        await manual.renew_jog()            # without renewal the adapter stops the axis
    await manual.stop()
"""

import asyncio
import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from orchestrator.client.fleet import FleetRequests
from orchestrator.client.states import VirtualFeed
from orchestrator.clock.owner import TaskOwner, running
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.jobs.service import AcquireAxes, AxesAcquired, ReleaseAxes
from orchestrator.model.messages import JogRequest, Reply
from orchestrator.model.operation.virtual_jog import STEP_S
from orchestrator.model.operation.virtual_ramp import VirtualRamp

VALID_MS = 200  # maximum validity of a jog
ANSWER_S = 0.5  # a later answer is useless: the axis has stopped by itself long before
JOG_TIMEOUT_S = 2.0  # for a new velocity: on a slow line it may take more than half a second
RENEW_S = 0.06  # between renewals of a request that is still on its way
RENEWALS_PER_LEASE = 3  # per lifetime of a lease

_LEASE_OVER = ("not-leased", "leased")


@dataclass(frozen=True, slots=True)
class _JogOrder:
    """Velocities by axis (unit/s), whether they renew earlier ones, and their validity and timeout. groups: of virtual
    axes that they move."""

    velocities: Mapping[str, float]
    renew: bool = False
    valid_ms: int = VALID_MS
    timeout_s: float = ANSWER_S
    groups: Sequence[str] = ()


class ManualControl:
    """The lease of `axes` (axes, groups, controllers) and the motion under it. Made by `Tutti.manual_control`.

    axes: the leased axes, as `controller.axis`; whole controllers where their axes cannot be leased separately. lost:
    why the lease ended before it was released (a permit, a stop, a coordinator that is gone); then nothing moves any
    more, and only another `manual_control` acquires the axes again.
    """

    def __init__(self, connection: FleetRequests, axes: Sequence[str], what: str, ttl_s: float) -> None:
        self.axes: list[str] = []
        self.lost: Refusal | None = None
        self.holder = f"manual-{connection.new_id()}"
        self._connection = connection
        self._wanted = list(axes)
        self._what = what
        self._ttl_s = ttl_s
        self._seq = 0
        self._velocities: dict[str, float] = {}
        self._is_broken_off = False
        self._renewals = TaskOwner()
        self._feed = VirtualFeed(connection)
        self._ramp = VirtualRamp(self._feed.states)
        self._ramp_number = 0
        self._stepped_s = 0.0

    async def __aenter__(self) -> Self:
        await self.acquire()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.release()

    # The lease

    async def acquire(self) -> None:
        """Acquire the axes and keep the lease renewed. Raises `Refusal`: codes `leased`, `permit`,
        `no-coordinator`."""
        await self._acquire(self._ttl_s)
        self._renewals.spawn(self._renew_lease())

    async def release(self) -> None:
        """Stop what still moves and release the axes. Raises nothing: a lease that is not renewed ends by itself."""
        self._renewals.cancel_all()
        with contextlib.suppress(Refusal):
            await self.stop()
        await self._feed.close()
        with contextlib.suppress(Refusal):
            request = ReleaseAxes(**self._connection.request_fields(), holder=self.holder)
            await self._connection.request_service("release-axes", request, Reply, self._ttl_s)

    async def _acquire(self, timeout_s: float) -> None:
        request = AcquireAxes(
            **self._connection.request_fields(),
            axes=self._wanted,
            holder=self.holder,
            what=self._what,
            ttl_s=self._ttl_s,
        )
        self.axes = (await self._connection.request_service("acquire-axes", request, AxesAcquired, timeout_s)).axes

    async def _renew_lease(self) -> None:
        """Renew the lease well within its lifetime, until it is refused."""
        pause_s = self._ttl_s / RENEWALS_PER_LEASE
        while True:
            await asyncio.sleep(pause_s)
            try:
                await self._acquire(self._ttl_s - pause_s)
            except Refusal as error:
                self.lost = error
                return

    # Motion

    async def jog(self, velocities: Mapping[str, float], valid_ms: int = VALID_MS) -> None:
        """Move each `controller.axis` at a velocity (its unit/s, user's direction) for `valid_ms`; 0 stops it.

        At most 200 ms, unless it is renewed. Returns when all controllers have accepted it, and renews it until then;
        one that refuses stops the others. Raises `Refusal`: codes `not-leased`, `leased`, `too-fast`, `soft-limit`,
        `not-enabled`, and others of the adapter.

        Virtual axes are jogged by their real ones, which this object must have; it returns when they have the velocity,
        at the end of their common ramp. They are not jogged together with real axes (code `mixed`).
        """
        if await self._are_virtual(velocities):
            self._ramp.request(velocities)
            await self._follow_ramp(valid_ms)
            return
        self._velocities.update(velocities)
        await self._send_velocities(_JogOrder(velocities, valid_ms=valid_ms, timeout_s=JOG_TIMEOUT_S))

    async def renew_jog(self, velocities: Mapping[str, float] | None = None, valid_ms: int = VALID_MS) -> None:
        """Continue all motion for `valid_ms` from now, at the last velocities, or at new ones (unit/s).

        Raises `Refusal`: code `not-jogging` for an axis that has been stopped meanwhile, or was not renewed in time.
        """
        if self._ramp.wanted or (velocities and await self._are_virtual(velocities)):
            self._ramp.require_jogging()
            self._ramp.request(velocities or {})
            await self._follow_ramp(valid_ms)
            return
        if self._is_broken_off:
            raise Refusal("not-jogging", "all axes were stopped when a controller refused", "begin with `jog`")
        has_changed = any(velocity != self._velocities.get(axis) for axis, velocity in (velocities or {}).items())
        self._velocities.update(velocities or {})
        moving_velocities = {axis: velocity for axis, velocity in self._velocities.items() if velocity}
        timeout_s = JOG_TIMEOUT_S if has_changed else ANSWER_S
        await self._send_velocities(_JogOrder(moving_velocities, renew=True, valid_ms=valid_ms, timeout_s=timeout_s))

    async def request_jog(self, velocities: Mapping[str, float], *, renew: bool = False) -> None:
        """`jog`, or `renew_jog`, by one request to each controller, which is not renewed while it is on its way.

        For a caller that passes on the requests of a user, and must not continue a motion that the user has ended.
        Raises `Refusal` as they do. A virtual axis has its velocity after some of them: each is one step of its ramp.
        """
        if await self._are_virtual(velocities):
            if renew:
                self._ramp.require_jogging()
            self._ramp.request(velocities)
            self._ramp_number += not renew
            await self._send_step(VALID_MS)
            return
        self._velocities.update(velocities)
        await self._request_jogs(_JogOrder(velocities, renew=renew, timeout_s=JOG_TIMEOUT_S))

    async def stop(self) -> None:
        """Stop all axes that this object has set in motion by their ramps, virtual ones by their common ramp. Raises
        `Refusal` if a controller does not answer."""
        if self._ramp.is_moving:
            self._ramp.request_rest()
            if not await self._follow_ramp(VALID_MS):
                return
        await self._halt()

    async def _halt(self) -> None:
        """Stop all axes at once, each by its own ramp."""
        self._ramp.clear()
        zeros = dict.fromkeys(self._velocities, 0.0)
        self._velocities.clear()
        for error in await asyncio.gather(*self._start_requests(_JogOrder(zeros)), return_exceptions=True):
            # The end of a lease stops its motion, so there is nothing left to stop.
            if error is not None and not (isinstance(error, Refusal) and error.code in _LEASE_OVER):
                raise error

    # Virtual axes

    async def _are_virtual(self, velocities: Mapping[str, float]) -> bool:
        """Whether `velocities` are of virtual axes, whose states are followed from now on. Raises `Refusal`, also while
        axes of the other kind are jogged."""
        # The lease names the real axes: their jogs need nothing from the coordinator.
        are_virtual = not all(axis in self.axes for axis in velocities) and await self._feed.follow(velocities)
        if velocities and any(self._velocities.values()) and are_virtual != self._ramp.is_moving:
            text = f"virtual and real axes cannot be jogged together; {', '.join(self._velocities)} moves"
            raise Refusal("mixed", text, "stop it first")
        return are_virtual

    async def _follow_ramp(self, valid_ms: int) -> bool:
        """Send steps of the ramp until it is at its end; return False when a later call goes on with it."""
        self._ramp_number += 1
        number = self._ramp_number
        while True:
            await self._send_step(valid_ms)
            if number == self._ramp_number and self._ramp.is_settled:
                return True
            await asyncio.sleep(STEP_S)
            if number != self._ramp_number:
                return False

    async def _send_step(self, valid_ms: int) -> None:
        """Send the next step of the ramp. What the ramp refuses ends it by its own way to rest; what a controller
        refuses, or does not answer within its validity, stops all axes at once: no real axis goes on alone."""
        now_s, was_moving = asyncio.get_running_loop().time(), self._ramp.is_moving
        try:
            self._feed.require_fresh(self._ramp.wanted)
            velocities = self._ramp.step(now_s - self._stepped_s)
            self._stepped_s = now_s
        except Refusal:
            is_braking = not any(self._ramp.wanted.values())
            with contextlib.suppress(Refusal):
                await (self._halt() if is_braking else self.stop())
            raise
        if not self._ramp.is_moving:
            velocities = dict.fromkeys({**self._velocities, **velocities}, 0.0)
        self._velocities = dict(velocities)
        try:
            await self._request_jogs(_JogOrder(velocities, was_moving, valid_ms, valid_ms / 1000, self._ramp.groups))
        except Refusal:
            with contextlib.suppress(Refusal):
                await self._halt()
            raise

    async def _send_velocities(self, order: _JogOrder) -> None:
        """Send velocities, and renew them until all controllers have answered: that may take longer than their
        validity."""
        renewing: list[asyncio.Task[None]] = []
        try:
            async with running(self._request_jogs(order)) as sending:
                while not (await asyncio.wait([sending], timeout=RENEW_S))[0]:
                    # Not those that have been stopped or changed meanwhile. Refusals are reported by the order itself.
                    moving_velocities = {
                        axis: v for axis, v in order.velocities.items() if v and self._velocities.get(axis) == v
                    }
                    renewing += self._start_requests(_JogOrder(moving_velocities, renew=True, valid_ms=order.valid_ms))
                sending.result()
        finally:
            for task in renewing:
                task.cancel()
                task.add_done_callback(lambda done_task: done_task.cancelled() or done_task.exception())

    async def _request_jogs(self, order: _JogOrder) -> None:
        if self.lost is not None:
            raise self.lost
        self._is_broken_off &= order.renew
        requests = self._start_requests(order)
        errors = [error for error in await asyncio.gather(*requests, return_exceptions=True) if error is not None]
        if not errors:
            return
        self._is_broken_off = len(requests) > 1
        if self._is_broken_off:
            with contextlib.suppress(Refusal):
                await self._halt()
        for error in errors:
            if isinstance(error, Refusal) and error.code == "not-leased":
                self._renewals.cancel_all()
                self.lost = self.lost or error
        raise errors[0]

    def _start_requests(self, order: _JogOrder) -> "list[asyncio.Task[None]]":
        """Start one request per controller. Their number increases: an older one that arrives late is refused."""
        self._seq += 1
        return [
            asyncio.get_running_loop().create_task(
                self._request_jog(
                    controller,
                    JogRequest(
                        **self._connection.request_fields(),
                        holder=self.holder,
                        seq=self._seq,
                        velocities={name: order.velocities[f"{controller}.{name}"] for name in names},
                        groups=list(order.groups),
                        renew=order.renew,
                        valid_ms=order.valid_ms,
                    ),
                    order.timeout_s,
                )
            )
            for controller, names in group_by_controller(order.velocities).items()
        ]

    async def _request_jog(self, controller: str, request: JogRequest, timeout_s: float) -> None:
        await self._connection.request_controller(controller, "jog", request, Reply, timeout_s)
