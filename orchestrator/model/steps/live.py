"""A live step: it runs what a program asks for while its job runs."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.numbers import Duration
from orchestrator.model.steps.base import Axes, AxesStep, Step
from orchestrator.model.steps.dwell import Dwell
from orchestrator.model.steps.home import Home
from orchestrator.model.steps.io import SetOutput, WaitInput
from orchestrator.model.steps.motors import Disable, Enable
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.wait_armed import WaitArmed

MAX_AHEAD = 100
"""Steps that a program may ask for before they begin."""
MAX_GATHER_NS = 1_000_000_000

AskedStep = Annotated[
    Move | FollowPath | Home | Enable | Disable | SetOutput | WaitInput | WaitArmed | Dwell, Field(discriminator="do")
]
"""A step that a program asks a live job for."""


class Live(AxesStep):
    """Steps that a program asks for while it runs, with the axes that they may move. It is the only step of its job."""

    moves: ClassVar[bool] = True
    is_swept: ClassVar[bool] = True
    is_open: ClassVar[bool] = True

    do: Literal["live"] = "live"
    axes: Axes
    outputs: list[str] = Field(
        default=[],
        max_length=100,
        description="Outputs `controller.output` that it may switch, besides those of the controllers of its axes.",
    )
    gather: Annotated[Duration, Field(ge=0, le=MAX_GATHER_NS)] = Field(
        default=0,
        description="Moves of different axes that are asked for within this time are one synchronised move; 0: each "
        "is one of its own.",
    )

    if TYPE_CHECKING:

        def __init__(
            self, *, axes: list[str], outputs: list[str] = ..., gather: str = "0 ms", name: str | None = None
        ) -> None: ...

    @property
    def points_steps(self) -> int:
        """The number of steps that run for one that was asked for."""
        return 1

    @property
    def switched_outputs(self) -> list[str]:
        return self.outputs

    def find_foreign(self, step: Step, fleet: Fleet) -> list[str]:
        """The axes and outputs that `step` uses and that are not of this live job. Raises `UnknownName`."""
        own_axes = set(self.find_axes(fleet))
        own_controllers = {controller_of(axis) for axis in own_axes}
        outputs = [*step.switched_outputs, *step.trigger_outputs]
        return [
            *(axis for axis in step.find_axes(fleet) if axis not in own_axes),
            *(name for name in outputs if name not in self.outputs and controller_of(name) not in own_controllers),
        ]
