"""Axes in hand: taken, jogged, given back.

async with tutti.by_hand(["gantry.x"], what="alignment") as hand:
    await hand.jog({"gantry.x": 5.0})       # mm/s, for 200 ms
    for _ in range(10):
        await asyncio.sleep(0.05)
        await hand.renew()                  # silence stops the axis, in its adapter
    await hand.stop()
"""

import asyncio
import contextlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Self

from orchestrator.client.api import Refused
from orchestrator.model.fleet import by_controller
from orchestrator.model.messages import JogRequest, Refusal, Reply
from orchestrator.model.service import GiveBack, Take, Taken

if TYPE_CHECKING:
    from orchestrator.client.api import Tutti

VALID_MS = 200  # what a jog is good for, at most
ANSWER_S = 0.5  # an answer that takes longer is of no use: the axis has stopped by itself long before
ORDER_S = 2.0  # for an order: of a slow line it may take more than half a second
RENEW_S = 0.06  # between renewals of an order that is still on its way
RENEWALS = 3  # in a lease's life

_NOT_OURS = ("not-leased", "leased")


class Hand:
    """The lease of `axes` (axes, groups, controllers) and what is moved by it. Made by `Tutti.by_hand`.

    axes: what is held, as `controller.axis`; whole controllers where their axes can not be told apart. lost: why the
    lease ended before it was given back (a permit, a stop, a coordinator that is gone); then nothing moves any more,
    and only another `by_hand` takes the axes again.
    """

    def __init__(self, tutti: "Tutti", axes: Sequence[str], what: str, ttl_s: float) -> None:
        self.axes: list[str] = []
        self.lost: Refusal | None = None
        self.holder = f"hand-{tutti.new_id()}"
        self._tutti = tutti
        self._wanted = list(axes)
        self._what = what
        self._ttl_s = ttl_s
        self._seq = 0
        self._velocities: dict[str, float] = {}
        self._keeper: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        await self.take()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.give_back()

    # The lease

    async def take(self) -> None:
        """Take the axes and hold them. Raises `Refused`: codes `leased`, `permit`, `no-coordinator`."""
        await self._take(self._ttl_s)
        self._keeper = asyncio.get_running_loop().create_task(self._keep())

    async def give_back(self) -> None:
        """Stop what still moves and give the axes back. Refuses nothing: a lease that nobody renews ends by itself."""
        self._keep_no_longer()
        with contextlib.suppress(Refused):
            await self.stop()
        with contextlib.suppress(Refused):
            request = GiveBack(**self._tutti.fields(), holder=self.holder)
            await self._tutti.service("release", request, Reply, self._ttl_s)

    async def _take(self, timeout_s: float) -> None:
        request = Take(
            **self._tutti.fields(), axes=self._wanted, holder=self.holder, what=self._what, ttl_s=self._ttl_s
        )
        self.axes = (await self._tutti.service("take", request, Taken, timeout_s)).axes

    async def _keep(self) -> None:
        """Renew the lease well within its life, until it is refused."""
        pause_s = self._ttl_s / RENEWALS
        while True:
            await asyncio.sleep(pause_s)
            try:
                await self._take(self._ttl_s - pause_s)
            except Refused as error:
                self.lost = error.refusal
                return

    def _keep_no_longer(self) -> None:
        if self._keeper is not None:
            self._keeper.cancel()
            self._keeper = None

    # Motion

    async def jog(self, velocities: Mapping[str, float], valid_ms: int = VALID_MS) -> None:
        """Move each `controller.axis` at a velocity (its unit/s, user's direction) for `valid_ms`; 0 stops it.

        At most 200 ms, unless it is renewed. Returns when all controllers have taken it, and renews it until then; one
        that refuses stops the others. Raises `Refused`: codes `not-leased`, `leased`, `too-fast`, `soft-limit`,
        `not-enabled`, and what else the adapter has against it.
        """
        self._velocities.update(velocities)
        await self._told(velocities, renew=False, valid_ms=valid_ms, timeout_s=ORDER_S)

    async def renew(self, velocities: Mapping[str, float] | None = None, valid_ms: int = VALID_MS) -> None:
        """Go on for `valid_ms` from now with all that moves, at the velocities asked for last, or at new ones (unit/s).

        Raises `Refused`: code `not-jogging` for an axis that somebody has stopped meanwhile, or that fell silent.
        """
        anew = any(velocity != self._velocities.get(axis) for axis, velocity in (velocities or {}).items())
        self._velocities.update(velocities or {})
        moving = {axis: velocity for axis, velocity in self._velocities.items() if velocity}
        await self._told(moving, renew=True, valid_ms=valid_ms, timeout_s=ORDER_S if anew else ANSWER_S)

    async def stop(self) -> None:
        """Stop by their ramps all axes that it has set in motion. Raises `Refused` if a controller does not answer."""
        begun = dict.fromkeys(self._velocities, 0.0)
        self._velocities.clear()
        for error in await asyncio.gather(
            *self._asked(begun, renew=False, valid_ms=VALID_MS, timeout_s=ANSWER_S), return_exceptions=True
        ):
            # What a holder moves is stopped when its lease ends: there is nothing left to stop.
            if error is not None and not (isinstance(error, Refused) and error.refusal.code in _NOT_OURS):
                raise error

    async def _told(self, velocities: Mapping[str, float], renew: bool, valid_ms: int, timeout_s: float) -> None:
        """Tell controllers, and renew it until they have answered: an order may take longer than it is good for."""
        telling = asyncio.get_running_loop().create_task(self._ask_all(velocities, renew, valid_ms, timeout_s))
        renewing: list[asyncio.Task[None]] = []
        try:
            while not (await asyncio.wait([telling], timeout=RENEW_S))[0]:
                # Not what was stopped or asked for anew meanwhile. What is wrong with it the order itself is told.
                moving = {axis: v for axis, v in velocities.items() if v and self._velocities.get(axis) == v}
                renewing += self._asked(moving, renew=True, valid_ms=valid_ms, timeout_s=ANSWER_S)
            telling.result()
        finally:
            telling.cancel()
            for task in renewing:
                task.cancel()
                task.add_done_callback(lambda done: done.cancelled() or done.exception())

    async def _ask_all(self, velocities: Mapping[str, float], renew: bool, valid_ms: int, timeout_s: float) -> None:
        if self.lost is not None:
            raise Refused(self.lost)
        asked = self._asked(velocities, renew, valid_ms, timeout_s)
        refused = [error for error in await asyncio.gather(*asked, return_exceptions=True) if error is not None]
        if not refused:
            return
        if len(asked) > 1:
            with contextlib.suppress(Refused):
                await self.stop()
        for error in refused:
            if isinstance(error, Refused) and error.refusal.code == "not-leased":
                self._keep_no_longer()
                self.lost = self.lost or error.refusal
        raise refused[0]

    def _asked(
        self, velocities: Mapping[str, float], renew: bool, valid_ms: int, timeout_s: float
    ) -> "list[asyncio.Task[None]]":
        """One request a controller, all on their way. Numbered here: an older one that comes late is refused."""
        self._seq += 1
        return [
            asyncio.get_running_loop().create_task(
                self._ask(
                    controller,
                    JogRequest(
                        **self._tutti.fields(),
                        holder=self.holder,
                        seq=self._seq,
                        velocities={name: velocities[f"{controller}.{name}"] for name in names},
                        renew=renew,
                        valid_ms=valid_ms,
                    ),
                    timeout_s,
                )
            )
            for controller, names in by_controller(velocities).items()
        ]

    async def _ask(self, controller: str, request: JogRequest, timeout_s: float) -> None:
        await self._tutti.command(controller, "jog", request, Reply, timeout_s)
