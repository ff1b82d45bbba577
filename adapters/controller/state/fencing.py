"""Command authority over a controller: epochs of leaders, and the e-stop latch. Both survive a crash of the adapter."""

import asyncio

from adapters.controller.state.store import PersistentMemory
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import (
    COMPARING,
    EPOCH_REMEDY,
    MAX_EPOCH_STEP,
    AcceptEpoch,
    AdoptRequest,
    FencedRequest,
)
from orchestrator.model.state import EstopLatch


class EpochFence:
    """Refuse former leaders, unknown leaders, and motion while an e-stop is latched.

    A restarted adapter refuses all commands until a leader adopts it again, although it remembers the highest epoch.
    """

    def __init__(self, remembered: PersistentMemory) -> None:
        self._remembered = remembered
        self._adopted = False
        self._compared = False
        self._reset_event = ""
        self._adopting = asyncio.Lock()

    @property
    def epoch(self) -> int:
        """The highest epoch seen so far."""
        return self._remembered.values.epoch

    @property
    def estop_latch(self) -> EstopLatch | None:
        return self._remembered.values.estop

    def allow_adoption(self) -> None:
        """The latches of other processes have been compared."""
        self._compared = True

    async def adopt_leader(self, request: AdoptRequest) -> bool:
        """Accept the leader of `request`; return True when it differs from the leader before. Raises `Refusal`,
        `OSError`.

        Requests of the new leader wait meanwhile: only leases of the former leader are dropped by the caller."""
        async with self._adopting:
            known_leader = self._remembered.values
            if not self._compared:
                raise Refusal(COMPARING, "e-stop latches are being compared with other processes", "try again")
            if self._is_outdated(request):
                raise Refusal(
                    "stale-epoch",
                    f"epoch {request.epoch} of coordinator {request.coordinator[:8]} is over; epoch "
                    f"{known_leader.epoch} of {known_leader.coordinator[:8]} has been seen",
                    EPOCH_REMEDY if known_leader.epoch > request.epoch + MAX_EPOCH_STEP else "stop the old coordinator",
                )
            if request.epoch > known_leader.epoch + MAX_EPOCH_STEP:
                raise Refusal(
                    "far-epoch",
                    f"epoch {request.epoch} is far from the known epoch {known_leader.epoch}: "
                    "no restart makes such a step",
                    EPOCH_REMEDY,
                )
            if (request.epoch, request.coordinator) != (known_leader.epoch, known_leader.coordinator):
                self._remembered.change_values(epoch=request.epoch, coordinator=request.coordinator)
                self._adopted = False
            await self.persist()
            fresh, self._adopted = not self._adopted, True
            return fresh

    async def accept_epoch(self, request: AcceptEpoch) -> None:
        """Remember the epoch of `request` as the highest one, and wait for its leader to adopt. Raises `OSError`."""
        async with self._adopting:
            await self._remembered.store_values(epoch=request.epoch, coordinator=request.coordinator)
            self._adopted = False

    async def require_current_leader(self, request: FencedRequest) -> None:
        """Raise `Refusal` unless `request` comes from the coordinator that adopted this controller."""
        async with self._adopting:
            known_leader = self._remembered.values
            if self._is_outdated(request):
                raise Refusal(
                    "stale-epoch", f"epoch {request.epoch} is over; the current epoch is {known_leader.epoch}", ""
                )
            if not self._adopted or request.epoch > known_leader.epoch:
                raise Refusal("not-adopted", "the controller has not been adopted in this epoch", "adopt it first")

    def _is_outdated(self, request: FencedRequest) -> bool:
        known_leader = self._remembered.values
        is_other = request.coordinator != known_leader.coordinator
        return request.epoch < known_leader.epoch or (request.epoch == known_leader.epoch and is_other)

    def require_no_estop(self) -> None:
        """Raise `Refusal` while an e-stop is latched."""
        latch = self._remembered.values.estop
        if latch is not None:
            raise Refusal(
                "estop-latched",
                f"e-stop {latch.event} by {latch.actor} is latched",
                "make the machine safe, then `tutti reset`",
            )

    def latch_estop(self, latch: EstopLatch) -> bool:
        """Latch the e-stop; `persist` saves it. Return False when one is latched already (the first one stays)."""
        if self._remembered.values.estop is not None:
            return False
        self._remembered.change_values(estop=latch)
        return True

    async def persist(self) -> None:
        """Save epoch and latch; both are on disk when this returns. Raises `OSError`."""
        await self._remembered.persist()

    def require_event(self, event: str | None) -> None:
        """Raise `Refusal` when the latched e-stop is not `event` (`None`: any e-stop)."""
        latch = self.estop_latch
        if latch is not None and event is not None and latch.event != event:
            raise Refusal("other-estop", f"the latched e-stop is {latch.event}, not {event}", "see `tutti status`")

    async def reset_latch(self) -> bool:
        """Reset the latch. Return False if none was latched. Raises `OSError`; then it stays: after a restart it would
        be back."""
        latch = self.estop_latch
        if latch is None:
            return False
        # Before it is stored, which takes a while: processes that keep it receive the reset later, and the leader's
        # heartbeat names it until then.
        self._reset_event = latch.event
        await self._remembered.store_values(estop=None)
        return True

    def misses_estop(self, event: str) -> bool:
        """Whether the e-stop `event` is neither latched here nor the one that was reset last: a process that keeps it
        for others receives the reset a moment later."""
        return self.estop_latch is None and event != self._reset_event
