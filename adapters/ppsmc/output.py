"""An output that a step switches at T0, and switches back."""

import asyncio

from adapters.contract import TimedWrite
from adapters.ppsmc.lines import PortOutput
from adapters.ppsmc.replies import ASK_OUTPUTS
from adapters.ppsmc.unitstate import PpSmcState
from orchestrator.clock.base import Clock, sleep_until_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal


class PpSmcOutput:
    """One output in one step. From `follow_write` on it runs by itself: it is passive again after its time."""

    def __init__(self, unit: PpSmcState, clock: Clock, drive: PortOutput) -> None:
        self._unit = unit
        self._clock = clock
        self._drive = drive
        self._outputs = 0
        self._order: TimedWrite | None = None
        self._after: asyncio.Task[None] | None = None
        self._failed = ""

    def check_passive(self, outputs: int) -> None:
        """Record the state of all outputs; raise `Refusal`, code `line-level`, when this one is already active."""
        self._outputs = outputs
        if self._drive.is_active(outputs):
            raise Refusal(
                "line-level",
                f"output {self._drive.name} (bit {self._drive.bit}) is already active",
                "make it passive first, and check `active` in the fleet file",
            )

    @property
    def on_command(self) -> str:
        """Return the command that makes it active (L1796)."""
        return f"dout{self._drive.outputs_with(self._outputs, True)}"

    @property
    def off_command(self) -> str:
        """Return the command that makes it passive."""
        return f"dout{self._drive.outputs_with(self._outputs, False)}"

    def follow_write(self, order: TimedWrite, until_ns: int) -> None:
        """Follow the timed write of the switching command `order`; make the output passive at `until_ns`."""
        self._order = order
        self._unit.driving = True
        self._after = asyncio.get_running_loop().create_task(self._make_passive_at(until_ns))

    def require_switched(self, outputs: int) -> None:
        """Raise `ControllerFault` when it was not switched."""
        if not self._drive.is_active(outputs):
            raise ControllerFault(
                "line-not-driven",
                f"output {self._drive.name} (bit {self._drive.bit}) is not active after it was switched",
                "is the i/o port option installed, and does another program write to it?",
            )

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
        await self._unit.session.send_repeatable((self.off_command,))

    def drop_output(self) -> None:
        """Drop the output: no further switching by itself."""
        if self._after is not None:
            self._after.cancel()
        self._unit.driving = False

    async def _make_passive_at(self, until_ns: int) -> None:
        await sleep_until_ns(self._clock, until_ns)
        try:
            heard = await self._unit.session.send_repeatable((self.off_command,), ASK_OUTPUTS)
            if self._drive.is_active(int(heard.first_text(ASK_OUTPUTS))):
                self._failed = f"output {self._drive.name} is still active after it was switched back"
            self._order = None
        except (ControllerFault, LinkClosed) as error:
            self._failed = f"output {self._drive.name} may still be active: {error}"
        self._unit.driving = False
