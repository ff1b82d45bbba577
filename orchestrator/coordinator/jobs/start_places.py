"""Which steps depend on where the axes stand when a job begins."""

from orchestrator.model.fleet import Fleet
from orchestrator.model.steps.base import Step
from orchestrator.plan.virtual_moves import find_virtual_names


class StartPlaces:
    """Follows the steps of a job in their order. A homing does not make an axis independent of its place: with some
    makes and methods it takes the place where the axis stands as its reference."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._known: set[str] = set()

    def take_step(self, step: Step) -> list[str]:
        """The real axes that `step`, as the first one, moves or counts from where they stand. step: one of
        `iterate_steps`."""
        # Virtual axes of a group that a step does not name stay where they are.
        axes = self._fleet.find_real_axes([*step.relative_axes, *find_virtual_names(self._fleet, step)])
        begin = [axis for axis in axes if axis not in self._known]
        self._known |= set(self._fleet.find_real_axes(step.placed_axes))
        return begin
