"""A homing: axes find their references."""

from typing import ClassVar, Literal

from orchestrator.model.steps.base import Axes, AxesStep


class Home(AxesStep):
    """Find the reference of axes; without `axes`, of the whole fleet in its `home_order`."""

    moves: ClassVar[bool] = True
    is_swept: ClassVar[bool] = True
    searches: ClassVar[bool] = True

    do: Literal["home"] = "home"
    axes: Axes | None = None

    @property
    def uses_whole_fleet(self) -> bool:
        return self.axes is None
