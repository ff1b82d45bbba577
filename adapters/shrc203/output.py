"""An output that a step switches at T0 (O:, L5311) and switches back."""

import asyncio

from adapters.contract import CannotDo, DriverFault, FireOrder
from adapters.shrc203.lines import Drive
from adapters.shrc203.replies import BITS, REFUSALS
from adapters.shrc203.session import Pending
from adapters.shrc203.unitstate import UnitState
from orchestrator.clock.base import Clock, sleep_until_ns
from orchestrator.link.base import LinkClosed


class DrivenOutput:
    """One output in one step. From `follow` on it takes care of itself: it is passive again after its time."""

    def __init__(self, unit: UnitState, clock: Clock, drive: Drive) -> None:
        self._unit = unit
        self._clock = clock
        self._drive = drive
        self._order: FireOrder | None = None
        self._pending: Pending | None = None
        self._after: asyncio.Task[None] | None = None
        self._failed = ""

    async def arm(self) -> None:
        """Read all outputs; raises `CannotDo`, code `line-level`, when this one is active already."""
        if self._unit.session.owed:
            raise CannotDo("busy", "a completion line is still due", "try again")
        self._unit.outputs = int(await self._unit.session.ask("?:O", BITS))
        if self._drive.is_active(self._unit.outputs):
            raise CannotDo(
                "line-level",
                f"output {self._drive.name} (OUT{self._drive.number}) is active already",
                "make it passive first, and look at `active` in the fleet file",
            )

    @property
    def on(self) -> str:
        """The line that makes it active."""
        return f"O:{self._drive.value(self._unit.outputs, True)}"

    @property
    def off(self) -> str:
        """The line that makes it passive."""
        return f"O:{self._drive.value(self._unit.outputs, False)}"

    def follow(self, order: FireOrder, pending: Pending, until_ns: int) -> None:
        """`order` will write `on`; make it passive at `until_ns`."""
        self._order, self._pending = order, pending
        self._unit.driving = True
        self._after = asyncio.get_running_loop().create_task(self._release(until_ns))

    async def switched(self) -> None:
        """Wait for the answer to the line that was written. Raises `DriverFault` when the output was not switched."""
        assert self._pending is not None and self._pending.reply is not None
        session = self._unit.session
        try:
            line = await asyncio.shield(self._pending.reply)
        except DriverFault:
            # The answer was lost. While a completion is owed, nothing that answers a digit can be asked.
            if session.owed or self._drive.is_active(int(await session.ask("?:O", BITS))):
                return
        else:
            if line.text not in REFUSALS:
                return
        raise DriverFault(
            "line-not-driven",
            f"the controller did not take {self._pending.command!r}: output {self._drive.name} was not switched",
            "look at its display",
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
        await self._unit.session.tell(self.off)

    def forget(self) -> None:
        """Do nothing more about it by itself."""
        if self._after is not None:
            self._after.cancel()
        self._unit.driving = False

    async def _release(self, until_ns: int) -> None:
        await sleep_until_ns(self._clock, until_ns)
        try:
            await self._unit.session.tell(self.off)
            self._order = None
        except (DriverFault, CannotDo, LinkClosed) as error:
            self._failed = f"output {self._drive.name} is perhaps still active: {error}"
        self._unit.driving = False
