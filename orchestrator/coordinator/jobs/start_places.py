"""Which steps depend on where the axes stand when a job begins."""

from orchestrator.model.steps.base import Step


class StartPlaces:
    """Follows the steps of a job in their order. A homing does not make an axis independent of its place: with some
    makes and methods it takes the place where the axis stands as its reference."""

    def __init__(self) -> None:
        self._known: set[str] = set()

    def take_step(self, step: Step) -> list[str]:
        """The axes that `step`, as the first one, moves or counts from where they stand. step: one of
        `iterate_steps`."""
        begin = [axis for axis in step.relative_axes if axis not in self._known]
        self._known |= set(step.placed_axes)
        return begin
