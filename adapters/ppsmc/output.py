"""An output that a step switches at T0, and switches back."""

import asyncio

from adapters.contract import CannotDo, DriverFault, FireOrder
from adapters.ppsmc.lines import Drive
from adapters.ppsmc.replies import ASK_OUTPUTS
from adapters.ppsmc.unitstate import UnitState
from orchestrator.clock.base import Clock, sleep_until_ns
from orchestrator.link.base import LinkClosed


class DrivenOutput:
    """One output in one step. From `follow` on it takes care of itself: it is passive again after its time."""

    def __init__(self, unit: UnitState, clock: Clock, drive: Drive) -> None:
        self._unit = unit
        self._clock = clock
        self._drive = drive
        self._outputs = 0
        self._order: FireOrder | None = None
        self._after: asyncio.Task[None] | None = None
        self._failed = ""

    def check(self, outputs: int) -> None:
        """Take note of all outputs; raises `CannotDo`, code `line-level`, when this one is active already."""
        self._outputs = outputs
        if self._drive.is_active(outputs):
            raise CannotDo(
                "line-level",
                f"output {self._drive.name} (bit {self._drive.bit}) is active already",
                "make it passive first, and look at `active` in the fleet file",
            )

    @property
    def on(self) -> str:
        """The line that makes it active (L1796)."""
        return f"dout{self._drive.byte(self._outputs, True)}"

    @property
    def off(self) -> str:
        """The line that makes it passive."""
        return f"dout{self._drive.byte(self._outputs, False)}"

    def follow(self, order: FireOrder, until_ns: int) -> None:
        """`order` will switch it; make it passive at `until_ns`."""
        self._order = order
        self._unit.driving = True
        self._after = asyncio.get_running_loop().create_task(self._release(until_ns))

    def require_switched(self, outputs: int) -> None:
        """Raises `DriverFault` when it was not switched."""
        if not self._drive.is_active(outputs):
            raise DriverFault(
                "line-not-driven",
                f"output {self._drive.name} (bit {self._drive.bit}) is not active after it was switched",
                "is the i/o port option installed, and does another program write to it?",
            )

    async def passive(self) -> str:
        """Wait until it is passive again, or `forget`; what is wrong with it, or "" when all is well."""
        if self._after is not None:
            await asyncio.wait({self._after})
        return self._failed

    async def end(self) -> None:
        """Make it passive now, if it may be active. The order to fire has been taken back, or carried out."""
        if self._order is None:
            return
        self.forget()
        # Whoever fires says whether it was in time to take the order back.
        await asyncio.gather(self._order.done(), return_exceptions=True)
        self._order = None
        await self._unit.session.settle((self.off,))

    def forget(self) -> None:
        """Do nothing more about it by itself."""
        if self._after is not None:
            self._after.cancel()
        self._unit.driving = False

    async def _release(self, until_ns: int) -> None:
        await sleep_until_ns(self._clock, until_ns)
        try:
            heard = await self._unit.session.settle((self.off,), ASK_OUTPUTS)
            if self._drive.is_active(int(heard.text(ASK_OUTPUTS))):
                self._failed = f"output {self._drive.name} is still active after it was switched back"
            self._order = None
        except (DriverFault, LinkClosed) as error:
            self._failed = f"output {self._drive.name} is perhaps still active: {error}"
        self._unit.driving = False
