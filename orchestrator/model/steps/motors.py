"""Motors are switched on and off."""

from typing import ClassVar, Literal

from orchestrator.model.steps.base import Axes, AxesStep


class Enable(AxesStep):
    """Switch motors on."""

    enables: ClassVar[bool] = True

    do: Literal["enable"] = "enable"
    axes: Axes


class Disable(AxesStep):
    """Switch motors off."""

    do: Literal["disable"] = "disable"
    axes: Axes
