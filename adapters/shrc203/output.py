"""An output that a step switches at T0 (O:, L5311) and switches back."""

import asyncio

from adapters.contract import TimedWrite
from adapters.shrc203.lines import OutputTrigger
from adapters.shrc203.replies import BITS, REFUSALS
from adapters.shrc203.session import ShrcPending
from adapters.shrc203.unitstate import ShrcState
from orchestrator.clock.base import Clock, sleep_until_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal


class ShrcOutput:
    """One output in one step. From `follow_write` on it runs by itself: it is passive again after its time."""

    def __init__(self, unit: ShrcState, clock: Clock, drive: OutputTrigger) -> None:
        self._unit = unit
        self._clock = clock
        self._drive = drive
        self._order: TimedWrite | None = None
        self._pending: ShrcPending | None = None
        self._after: asyncio.Task[None] | None = None
        self._failed = ""

    async def read_and_check(self) -> None:
        """Read all outputs; raise `Refusal`, code `line-level`, when this one is already active."""
        if self._unit.session.expected_completions:
            raise Refusal("busy", "a completion line is still outstanding", "try again")
        self._unit.outputs = int(await self._unit.session.send_query("?:O", BITS))
        if self._drive.is_active(self._unit.outputs):
            raise Refusal(
                "line-level",
                f"output {self._drive.name} (OUT{self._drive.number}) is already active",
                "make it passive first, and check `active` in the fleet file",
            )

    @property
    def on_command(self) -> str:
        """Return the command that makes it active."""
        return f"O:{self._drive.outputs_with(self._unit.outputs, True)}"

    @property
    def off_command(self) -> str:
        """Return the command that makes it passive."""
        return f"O:{self._drive.outputs_with(self._unit.outputs, False)}"

    def follow_write(self, order: TimedWrite, pending: ShrcPending, until_ns: int) -> None:
        """Follow the timed write of the activating command `order`; make the output passive at `until_ns`."""
        self._order, self._pending = order, pending
        self._unit.driving = True
        self._after = asyncio.get_running_loop().create_task(self._make_passive_at(until_ns))

    async def wait_until_switched(self) -> None:
        """Wait for the reply to the written command. Raises `ControllerFault` when the output was not switched."""
        assert self._pending is not None and self._pending.reply is not None
        session = self._unit.session
        try:
            line = await asyncio.shield(self._pending.reply)
        except ControllerFault:
            # The reply was lost. While a completion is outstanding, no query with a digit as its answer is possible.
            if session.expected_completions or self._drive.is_active(int(await session.send_query("?:O", BITS))):
                return
        else:
            if line.text not in REFUSALS:
                return
        raise ControllerFault(
            "line-not-driven",
            f"the controller did not accept {self._pending.command!r}: output {self._drive.name} was not switched",
            "see its display",
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
        await self._unit.session.send_setting(self.off_command)

    def drop_output(self) -> None:
        """Drop the output: no further switching by itself."""
        if self._after is not None:
            self._after.cancel()
        self._unit.driving = False

    async def _make_passive_at(self, until_ns: int) -> None:
        await sleep_until_ns(self._clock, until_ns)
        try:
            await self._unit.session.send_setting(self.off_command)
            self._order = None
        except (ControllerFault, Refusal, LinkClosed) as error:
            self._failed = f"output {self._drive.name} may still be active: {error}"
        self._unit.driving = False
