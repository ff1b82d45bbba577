"""An output that a step switches at T0 (O:, L5311) and switches back."""

import asyncio

from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import BITS, REFUSALS
from adapters.shrc203.wire.reply_queue import ShrcPending
from adapters.toolkit.wired_points import WiredOutput
from orchestrator.model.errors import ControllerFault, Refusal


class ShrcOutput:
    """One output in one step: the commands that switch it, and their replies."""

    def __init__(self, unit: ShrcState, drive: WiredOutput) -> None:
        self.drive = drive
        self._unit = unit

    @property
    def name(self) -> str:
        return self.drive.name

    async def read_and_check(self) -> None:
        """Read all outputs; raise `Refusal`, code `line-level`, when this one is already active."""
        if self._unit.session.completions.expected:
            raise Refusal("busy", "a completion line is still outstanding", "try again")
        self._unit.outputs = int(await self._unit.session.send_query("?:O", BITS))
        if self.drive.is_active(self._unit.outputs):
            raise Refusal(
                "line-level",
                f"output {self.drive.name} (OUT{self.drive.number}) is already active",
                "make it passive first, and check `active` in the fleet file",
            )

    @property
    def on_command(self) -> str:
        """Return the command that makes it active."""
        return f"O:{self.drive.active_value(self._unit.outputs)}"

    @property
    def off_command(self) -> str:
        """Return the command that makes it passive."""
        return f"O:{self.drive.passive_value(self._unit.outputs)}"

    async def wait_until_switched(self, pending: ShrcPending) -> None:
        """Wait for the reply to the written command. Raises `ControllerFault` when the output was not switched."""
        session = self._unit.session
        try:
            line = await asyncio.shield(pending.answer.future)
        except ControllerFault:
            # The reply was lost. While a completion is outstanding, no query with a digit as its answer is possible.
            if session.completions.expected or self.drive.is_active(int(await session.send_query("?:O", BITS))):
                return
        else:
            if line.text not in REFUSALS:
                return
        raise ControllerFault(
            "line-not-driven",
            f"the controller did not accept {pending.command!r}: output {self.drive.name} was not switched",
            "see its display",
        )

    async def switch_off(self) -> None:
        await self._unit.session.send_setting(self.off_command)

    async def switch_off_and_check(self) -> str:
        await self.switch_off()
        return ""

    def set_driving(self, *, driving: bool) -> None:
        self._unit.driving = driving


class ManualOutputs:
    """The outputs of one controller, switched one at a time: all of them are written together."""

    def __init__(self) -> None:
        self._turn = asyncio.Lock()

    async def set_output(self, unit: ShrcState, number: int, *, on: bool) -> None:
        """Switch one output. Raises `Refusal` while an axis moves, or a step drives one."""
        if unit.session.completions.expected:
            raise Refusal("moving", "outputs cannot be read back while an axis moves", "wait for the end of the motion")
        if unit.driving:
            raise Refusal(
                "busy", "a step drives an output, and all outputs are written together", "wait for the end of the step"
            )
        async with self._turn:
            levels, bit = int(await unit.session.send_query("?:O", BITS)), 1 << (number - 1)
            unit.outputs = levels | bit if on else levels & ~bit
            await unit.session.send_setting(f"O:{unit.outputs}")
