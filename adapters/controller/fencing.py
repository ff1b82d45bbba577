"""Who may command a controller: epochs of coordinators, and the e-stop latch. Kept over the adapter's own death."""

import asyncio

from adapters.contract import CannotDo
from adapters.controller.store import Remembered
from orchestrator.model.messages import Adopt, Fenced
from orchestrator.model.state import EstopLatch


class Fence:
    """Refuses old coordinators, unknown ones, and motion while an e-stop is latched.

    A restarted adapter obeys nobody until it is adopted anew, although it remembers the highest epoch.
    """

    def __init__(self, remembered: Remembered) -> None:
        self._remembered = remembered
        self._adopted = False
        self._adopting = asyncio.Lock()

    @property
    def epoch(self) -> int:
        """The highest epoch ever seen."""
        return self._remembered.now.epoch

    @property
    def latch(self) -> EstopLatch | None:
        return self._remembered.now.estop

    async def adopt(self, request: Adopt) -> bool:
        """Take the coordinator of `request`; True when it is another reign than before. Raises `CannotDo`,
        `OSError`. Whoever asks for something in that reign meanwhile waits: what the caller drops because of it are the
        leases of the one before."""
        async with self._adopting:
            known = self._remembered.now
            if self._is_over(request):
                raise CannotDo(
                    "stale-epoch",
                    f"epoch {request.epoch} of coordinator {request.coordinator[:8]} is over; epoch {known.epoch} "
                    f"of {known.coordinator[:8]} has been seen",
                    "stop the old coordinator",
                )
            if (request.epoch, request.coordinator) != (known.epoch, known.coordinator):
                self._remembered.change(epoch=request.epoch, coordinator=request.coordinator)
                self._adopted = False
            await self.keep()
            fresh, self._adopted = not self._adopted, True
            return fresh

    async def admit(self, request: Fenced) -> None:
        """Raises `CannotDo` unless `request` comes from the coordinator that adopted this controller."""
        async with self._adopting:
            known = self._remembered.now
            if self._is_over(request):
                raise CannotDo("stale-epoch", f"epoch {request.epoch} is over; epoch {known.epoch} rules", "")
            if not self._adopted or request.epoch > known.epoch:
                raise CannotDo("not-adopted", "the controller has not been adopted in this reign", "adopt it first")

    def _is_over(self, request: Fenced) -> bool:
        known = self._remembered.now
        other = request.coordinator != known.coordinator
        return request.epoch < known.epoch or (request.epoch == known.epoch and other)

    def require_no_estop(self) -> None:
        """Raises `CannotDo` while an e-stop is latched."""
        latch = self._remembered.now.estop
        if latch is not None:
            raise CannotDo(
                "estop-latched", f"e-stop {latch.event} by {latch.actor} is latched", "make it safe, then `tutti reset`"
            )

    def latch_estop(self, latch: EstopLatch) -> bool:
        """Latch, to be kept with `keep`; False when one is latched already (the first one keeps its name)."""
        if self._remembered.now.estop is not None:
            return False
        self._remembered.change(estop=latch)
        return True

    async def keep(self) -> None:
        """Epoch and latch are safe when this returns. Raises `OSError`."""
        await self._remembered.keep()

    def require_event(self, event: str | None) -> None:
        """Raises `CannotDo` when another e-stop than `event` is latched (`None`: any will do)."""
        latch = self.latch
        if latch is not None and event is not None and latch.event != event:
            raise CannotDo("other-estop", f"the latched e-stop is {latch.event}, not {event}", "look at `tutti status`")

    async def release(self) -> bool:
        """Release the latch. False if none was latched. Raises `OSError`."""
        if self.latch is None:
            return False
        self._remembered.change(estop=None)
        await self.keep()
        return True
