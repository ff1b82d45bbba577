"""The play of drives: how far axes are ahead of their motors, followed from step to step and from poll to poll."""

from collections.abc import Collection, Iterable, Mapping

from adapters.contract import ControllerReading
from adapters.controller.state.armed_step import ArmedStep
from orchestrator.model.compensation import Play
from orchestrator.model.fleet import Controller


class PlayFollower:
    """The play of the drives of one controller. It is unknown at first, and after what may have set a position."""

    def __init__(self, config: Controller) -> None:
        drives = {name: axis.play for name, axis in config.axes.items()}
        self._whole: Mapping[str, Play] = {name: play for name, play in drives.items() if play is not None}
        self._present = dict(self._whole)
        self._counts: dict[str, int] = {}
        """Where motors were seen last, or where their last step has ended."""
        self._directions: dict[str, int] = {}
        """Of their last motions since then; 0: from rest."""
        self._ended: ArmedStep | None = None
        self._homing = frozenset[str]()
        """At the last reading."""

    def find_play(self, axis: str) -> Play | None:
        """How far an axis is ahead of its motor; None for a drive without play."""
        return self._present.get(axis)

    def forget(self, axes: Iterable[str]) -> None:
        """The counts of axes no longer tell how they were moved."""
        self._present |= {name: self._whole[name] for name in axes if name in self._whole}

    def end_step(self, step: ArmedStep) -> None:
        """A step has ended as planned. It is not told twice, and between two steps there may be no reading."""
        if not self._whole or step.is_same(self._ended):
            return
        self._ended = step
        for name, way in step.ways.items():
            if name not in self._whole:
                continue
            low, high = sorted((way.start, way.end))
            if way.low < low - way.error or way.high > high + way.error:
                self.forget([name])  # it has turned back on its way
            elif name in self._counts:
                self._follow(name, way.end)
            self._counts[name], self._directions[name] = way.end, 0

    def handle_reading(self, reading: ControllerReading, homing: Collection[str]) -> None:
        """Follow the motors to a reading. homing: axes that search for their reference."""
        for name in self._whole:
            axis, is_first = reading.axes[name], name not in self._counts
            if is_first or reading.restarted or axis.position_lost or name in homing or name in self._homing:
                self.forget([name])
            else:
                self._follow(name, axis.commanded_counts)
            self._counts[name] = axis.commanded_counts
            if not axis.moving:
                self._directions[name] = 0
        self._homing = frozenset(homing)

    def lose_sight(self) -> None:
        """The link is lost: the motors may be moved by anything until it is back."""
        self._counts = {}

    def _follow(self, name: str, counts: int) -> None:
        by = counts - self._counts[name]
        if not by:
            return
        direction = 1 if by > 0 else -1
        # It may have been farther than any reading shows, and have come back.
        if direction == -self._directions.get(name, 0):
            self.forget([name])
        self._directions[name] = direction
        self._present[name] = self._present[name].follow(by, self._whole[name])
