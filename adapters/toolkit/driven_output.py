"""An output that a step switches at T0 and switches back, for makes whose host writes both commands."""

import asyncio
from typing import Generic, Protocol, TypeVar

from adapters.contract import TimedWrite
from orchestrator.clock.base import Clock, sleep_until_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal


class OutputPort(Protocol):
    """The make's part of a driven output."""

    @property
    def name(self) -> str: ...

    async def switch_off(self) -> None:
        """Make the output passive. Raises `ControllerFault`, `Refusal`, `LinkClosed`."""
        ...

    async def switch_off_and_check(self) -> str:
        """Make the output passive, and return its failure, or "". Raises like `switch_off`."""
        ...

    def set_driving(self, *, driving: bool) -> None:
        """Set whether a step switches an output."""
        ...


_Port = TypeVar("_Port", bound=OutputPort)


class DrivenOutput(Generic[_Port]):
    """One output in one step. From `follow_write` on it runs by itself: it is passive again after its time."""

    def __init__(self, clock: Clock, port: _Port) -> None:
        self.port = port
        self._clock = clock
        self._order: TimedWrite | None = None
        self._after: asyncio.Task[None] | None = None
        self._failed = ""

    def follow_write(self, order: TimedWrite, until_ns: int) -> None:
        """Follow the timed write of the activating command `order`; make the output passive at `until_ns`."""
        self._order = order
        self.port.set_driving(driving=True)
        self._after = asyncio.get_running_loop().create_task(self._make_passive_at(until_ns))

    async def wait_until_passive(self) -> str:
        """Wait until it is passive again, or dropped; return its failure, or ""."""
        if self._after is not None:
            await asyncio.wait({self._after})
        return self._failed

    async def make_passive(self) -> None:
        """Make it passive now, if it may be active. The timed write has been cancelled or executed."""
        if self._order is None:
            return
        self.drop_output()
        # The timed writer reports whether the cancellation was in time.
        await asyncio.gather(self._order.wait_until_written(), return_exceptions=True)
        self._order = None
        await self.port.switch_off()

    def drop_output(self) -> None:
        """Drop the output: no further switching by itself."""
        if self._after is not None:
            self._after.cancel()
        self.port.set_driving(driving=False)

    async def _make_passive_at(self, until_ns: int) -> None:
        await sleep_until_ns(self._clock, until_ns)
        try:
            self._failed = await self.port.switch_off_and_check()
            self._order = None
        except (ControllerFault, Refusal, LinkClosed) as error:
            self._failed = f"output {self.port.name} may still be active: {error}"
        self.port.set_driving(driving=False)
