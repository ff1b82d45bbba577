"""Verbs of a live job, each until it is done."""

from abc import ABC, abstractmethod

from orchestrator.model.report import StepReport
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.dwell import Dwell
from orchestrator.model.steps.home import Home
from orchestrator.model.steps.io import SetOutput, WaitInput
from orchestrator.model.steps.motors import Disable, Enable
from orchestrator.model.steps.path import FollowPath


class LiveVerbs(ABC):
    """Steps that are no moves, and paths, of a live job."""

    @property
    @abstractmethod
    def axes(self) -> list[str]:
        """The axes, groups and controllers that it was begun with."""

    @abstractmethod
    async def run(self, step: Step) -> StepReport:
        """Run one step, and return its report when it is done."""

    async def path(self, path: FollowPath) -> StepReport:
        """Move axes along a path, from its start. Raises as `move` does, and `FileError` for a file of a path."""
        return await self.run(path)

    async def home(self, *axes: str) -> StepReport:
        """Find the reference of axes; without any, of all of this live job. Raises as `move` does."""
        return await self.run(Home(axes=list(axes) or self.axes))

    async def enable(self, *axes: str) -> StepReport:
        """Switch motors on; without axes, of all of this live job. Raises as `move` does."""
        return await self.run(Enable(axes=list(axes) or self.axes))

    async def disable(self, *axes: str) -> StepReport:
        """Switch motors off; without axes, of all of this live job. Raises as `move` does."""
        return await self.run(Disable(axes=list(axes) or self.axes))

    async def output(self, output: str, *, on: bool = True, pulse_s: float | None = None) -> StepReport:
        """Switch the output `controller.output`; back after `pulse_s`. Raises as `move` does."""
        pulse = None if pulse_s is None else f"{pulse_s:.9f} s"
        return await self.run(SetOutput(output=output, value=on, pulse=pulse))

    async def wait_input(self, name: str, *, on: bool = True, timeout_s: float = 10.0) -> StepReport:
        """Wait until the input `controller.input` is active (`on=False`: passive). Raises as `move` does."""
        return await self.run(WaitInput(input=name, value=on, timeout=f"{timeout_s:.9f} s"))

    async def dwell(self, seconds: float) -> StepReport:
        """Wait, as a step of the fleet's own. Raises as `move` does."""
        return await self.run(Dwell(duration=f"{seconds:.9f} s"))
