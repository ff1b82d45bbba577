"""Ground truth: the record of all commanded motions."""

from collections.abc import Callable, Mapping

from sim.core.controller import CommandedMotion
from sim.yaskawa.base.timebase import NEVER_NS, ServoTimebase
from sim.yaskawa.motion.axis import ServoAxis


class MotionRecord:
    """Commanded motions of the axes and of their followers. Instants are samples. names: by which they are recorded,
    where these are not the machine's own."""

    def __init__(
        self,
        timebase: ServoTimebase,
        axes: tuple[ServoAxis, ...],
        cam_master: Callable[[], str | None],
        names: Mapping[str, str],
    ) -> None:
        self._names = names
        self._timebase = timebase
        self._axes = axes
        self._cam_master = cam_master
        self.motions: list[CommandedMotion] = []

    def note_start(self, axis: ServoAxis, at: int) -> None:
        """Record the start of a commanded motion, of the axis and of its geared followers."""
        for follower in (axis, *self.geared_followers(axis)):
            if follower.motion is None:
                start_ns = self._timebase.true_ns(at)
                name = self._names.get(follower.name, follower.name)
                follower.motion = CommandedMotion(name, start_ns, follower.command_at(at))
                self.motions.append(follower.motion)

    def resume_samples(self) -> None:
        """Restart the motions that began without a sample clock at its next sample."""
        for axis in self._axes:
            if axis.motion is not None and axis.motion.start_ns == NEVER_NS:
                axis.motion.start_ns = self._timebase.true_ns(self._timebase.current_sample() + 1)

    def note_slowing(self, axis: ServoAxis, at: int) -> None:
        """Record that a stop takes effect at sample `at`."""
        if axis.motion is not None and axis.motion.slowing_ns is None:
            axis.motion.slowing_ns = self._timebase.true_ns(at)

    def note_end(self, axis: ServoAxis, at: int) -> None:
        """Record the last commanded change at sample `at`."""
        for follower in (axis, *self.geared_followers(axis)):
            motion = follower.motion
            if motion is not None and (follower is axis or not follower.is_moving):
                motion.end_ns = self._timebase.true_ns(at)
                motion.end_counts = follower.command_at(at)
                follower.motion = None

    def geared_followers(self, master: ServoAxis) -> list[ServoAxis]:
        """Return the axes that a gear or a cam moves with `master`."""
        return [
            axis
            for axis in self._axes
            if axis is not master
            and (
                (axis.gear.is_engaged and axis.gear.source.removeprefix("C") == master.name)
                or (axis.mode == "cam" and self._cam_master() == master.name)
            )
        ]
