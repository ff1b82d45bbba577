"""Which steps depend on where the axes stand when a job begins."""

from orchestrator.model.job import FollowPath, Move, Scan, SetPosition, Step


class StartPlaces:
    """Follows the steps of a job in their order. A homing does not make an axis independent of its place: with some
    makes and methods it takes the place where the axis stands as its reference."""

    def __init__(self) -> None:
        self._known: set[str] = set()

    def take_step(self, step: Step) -> list[str]:
        """The axes that `step`, as the first one, moves or counts from where they stand. step: one of
        `iterate_steps`."""
        if isinstance(step, Scan):
            self._known |= set(step.axis_names)
            return []
        if isinstance(step, FollowPath):
            # It begins where its axes stand.
            begin = [axis for axis in step.axes if axis not in self._known]
            self._known |= set(step.axes)
            return begin
        if isinstance(step, Move):
            begin = [axis for axis in step.by if axis not in self._known]
            self._known |= {*step.to, *step.by}
            return begin
        if isinstance(step, SetPosition):
            # Later targets of this axis are counted from here.
            begin = [axis for axis, value in step.axes.items() if value is not None and axis not in self._known]
            self._known |= set(begin)
            return begin
        return []
