"""The play of drives: how far axes are ahead of their motors, followed from poll to poll."""

from collections.abc import Collection, Iterable, Mapping

from adapters.contract import AxisReading, ControllerReading
from orchestrator.model.compensation import Play
from orchestrator.model.fleet import Controller


class PlayFollower:
    """The play of the drives of one controller. It is unknown at first, and after what may have set a position."""

    def __init__(self, config: Controller) -> None:
        self._whole: Mapping[str, Play] = {
            name: axis.play for name, axis in config.axes.items() if axis.play is not None
        }
        self._present = dict(self._whole)
        self._directions: dict[str, int] = {}
        self._homing = frozenset[str]()
        """At the last reading."""

    def find_play(self, axis: str) -> Play | None:
        """How far an axis is ahead of its motor; None for a drive without play."""
        return self._present.get(axis)

    def forget(self, axes: Iterable[str]) -> None:
        """The counts of axes no longer tell how they were moved."""
        self._present |= {name: self._whole[name] for name in axes if name in self._whole}

    def handle_reading(
        self, before: ControllerReading | None, reading: ControllerReading, homing: Collection[str]
    ) -> None:
        """Follow the motors from one reading to the next one. homing: axes that search for their reference."""
        if before is None or reading.restarted:
            self.forget(self._whole)
            return
        for name, whole in self._whole.items():
            if name in homing or name in self._homing or reading.axes[name].position_lost:
                self.forget([name])
            else:
                self._follow_axis(name, whole, before.axes[name], reading.axes[name])
        self._homing = frozenset(homing)

    def _follow_axis(self, name: str, whole: Play, before: AxisReading, axis: AxisReading) -> None:
        by = axis.commanded_counts - before.commanded_counts
        direction = (by > 0) - (by < 0)
        # It may have been farther than any reading shows, and have come back.
        if before.moving and direction and direction == -self._directions.get(name, direction):
            self.forget([name])
        if direction:
            self._directions[name] = direction
            self._present[name] = self._present[name].follow(by, whole)
