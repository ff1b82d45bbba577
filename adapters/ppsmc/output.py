"""An output that a step switches at T0, and switches back."""

from adapters.ppsmc.replies import ASK_OUTPUTS
from adapters.ppsmc.unitstate import PpSmcState
from adapters.toolkit.wired_points import WiredOutput
from orchestrator.model.errors import ControllerFault, Refusal


class PpSmcOutput:
    """One output in one step: the commands that switch it."""

    def __init__(self, unit: PpSmcState, drive: WiredOutput) -> None:
        self.drive = drive
        self._unit = unit
        self._outputs = 0

    @property
    def name(self) -> str:
        return self.drive.name

    def check_passive(self, outputs: int) -> None:
        """Record the state of all outputs; raise `Refusal`, code `line-level`, when this one is already active."""
        self._outputs = outputs
        if self.drive.is_active(outputs):
            raise Refusal(
                "line-level",
                f"output {self.drive.name} (bit {self.drive.bit}) is already active",
                "make it passive first, and check `active` in the fleet file",
            )

    @property
    def on_command(self) -> str:
        """Return the command that makes it active (L1796)."""
        return f"dout{self.drive.active_value(self._outputs)}"

    @property
    def off_command(self) -> str:
        """Return the command that makes it passive."""
        return f"dout{self.drive.passive_value(self._outputs)}"

    def require_switched(self, outputs: int) -> None:
        """Raise `ControllerFault` when it was not switched."""
        if not self.drive.is_active(outputs):
            raise ControllerFault(
                "line-not-driven",
                f"output {self.drive.name} (bit {self.drive.bit}) is not active after it was switched",
                "is the i/o port option installed, and does another program write to it?",
            )

    async def switch_off(self) -> None:
        await self._unit.session.send_repeatable((self.off_command,))

    async def switch_off_and_check(self) -> str:
        reply = await self._unit.session.send_repeatable((self.off_command,), ASK_OUTPUTS)
        if self.drive.is_active(int(reply.first_text(ASK_OUTPUTS))):
            return f"output {self.name} is still active after it was switched back"
        return ""

    def set_driving(self, *, driving: bool) -> None:
        self._unit.driving = driving
