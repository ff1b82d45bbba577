"""The slots of an SMC-2000: on a chain its exchanges wait for their turn, and no poll delays a start."""

from collections.abc import Callable, Mapping
from contextlib import AbstractAsyncContextManager, nullcontext

from adapters.contract import DriverLog
from adapters.yaskawa.common.jogging import YaskawaJogging
from adapters.yaskawa.common.loads import YaskawaLowered
from adapters.yaskawa.common.slots import SampleMover
from adapters.yaskawa.common.start import SampleStart
from adapters.yaskawa.smc2000.device import SerialDevice
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.estimator import TickMapping

AFTER_START_NS = 3 * NS_PER_MS  # for the program to record its start


class SerialMover(SampleMover):
    """The mover of one slot. poll_ns: returns the longest duration of a poll, ns."""

    def __init__(
        self,
        start: SampleStart,
        jogging: YaskawaJogging,
        log: DriverLog,
        device: SerialDevice,
        poll_ns: Callable[[], int],
    ) -> None:
        super().__init__(start, jogging, log)
        self._device = device
        self._poll_ns = poll_ns

    async def _load_at_rest(
        self, lowered: YaskawaLowered, t0_ns: int, mapping: TickMapping | None
    ) -> Mapping[str, int]:
        # In one turn, or the other controllers' polls would come in between; but not for the duration of an upload.
        long = lowered.load.contour is not None or lowered.switches is not None
        async with nullcontext() if long else self._device.exclusive_turn():
            stages = await super()._load_at_rest(lowered, t0_ns, mapping)
        self._suspend_polls(t0_ns)
        return stages

    async def _load_beside(self, lowered: YaskawaLowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        stages = await super()._load_beside(lowered, t0_ns, mapping)
        self._suspend_polls(t0_ns)
        return stages

    def _suspend_polls(self, t0_ns: int) -> None:
        self._device.session.suspend_polls(t0_ns - self._poll_ns(), t0_ns + AFTER_START_NS)

    def _take_turn(self) -> AbstractAsyncContextManager[None]:
        """Return a turn for the exchanges of the present move. The following one has none: the controllers on its line
        move, and their watchdogs must be extended meanwhile."""
        return nullcontext() if self.is_following else self._device.exclusive_turn()

    async def verify(self) -> None:
        async with self._take_turn():
            await super().verify()

    async def release(self, start_tolerance_ns: int, advance_ns: int) -> None:
        async with self._take_turn():
            await super().release(start_tolerance_ns, advance_ns)

    async def unload(self) -> None:
        if not self.is_following:
            self._device.session.suspend_polls(0, 0)
        await super().unload()
