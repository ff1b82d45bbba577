"""When a step of a drive begins and ends: the bounds by its options, the bitrate of its bus and its crystal."""

from math import ceil, floor

from adapters.cia402.costs import full_frame_ns, sync_ns
from adapters.cia402.lowering import Cia402Lowered
from adapters.cia402.options import Cia402Options
from adapters.cia402.shapes.course import SetpointTrajectory
from adapters.cia402.sync.stream import StreamedMove
from adapters.contract import HostInterval
from orchestrator.clock.base import NS_PER_S, NS_PER_US

_SHORTEST_SYNC = 2  # ratio of the bits of its longest form to its shortest one, at the most


class DriveTiming:
    """The bounds of the motions of one drive, ns of the host's clock. bitrate: of its bus, bit/s."""

    def __init__(self, options: Cia402Options, bitrate: int) -> None:
        self._options = options
        self._bitrate = bitrate

    @property
    def after_taking_ns(self) -> int:
        """Return the longest time from accepting a set-point to the motion."""
        options = self._options
        return (options.cycle_us + options.start_us + options.start_spread_us) * NS_PER_US

    def guaranteed_start(self, written_ns: int) -> tuple[int, int]:
        """Return the guaranteed interval of the start after the SYNC was written at `written_ns`."""
        options, bitrate = self._options, self._bitrate
        least_us = max(0, options.start_us - options.start_spread_us)
        earliest_ns = written_ns + sync_ns(bitrate) // _SHORTEST_SYNC + least_us * NS_PER_US
        wire_ns = options.wire_jitter_us * NS_PER_US + full_frame_ns(bitrate) + sync_ns(bitrate)
        return earliest_ns, written_ns + wire_ns + self.after_taking_ns

    def end_interval(self, lowered: Cia402Lowered, started: HostInterval) -> tuple[int, int]:
        """Return when a step that has begun in `started` ends, as far as it is released."""
        seconds, between_ns = lowered.durations_s[lowered.axis], self._between_ns(lowered)
        return (
            started.earliest_ns + self._device_ns(seconds, -1) - between_ns,
            started.latest_ns + self._device_ns(seconds, 1) + between_ns,
        )

    def stream_end_interval(self, ride: StreamedMove, trajectory: SetpointTrajectory) -> tuple[int, int]:
        """Return the interval of the end: a period after its last SYNC took effect; on a path it may have been there
        before."""
        earliest_ns, latest_ns = self.guaranteed_start(ride.last_written_ns)
        if ride.last_answer_ns:
            latest_ns = max(earliest_ns, min(latest_ns, ride.last_answer_ns + self.after_taking_ns))
        period_s = trajectory.period_ns / NS_PER_S
        if trajectory.is_chunk:
            earliest_ns -= self.still_ns(trajectory)[1]
        return earliest_ns + self._device_ns(period_s, -1), latest_ns + self._device_ns(period_s, 1)

    def still_ns(self, trajectory: SetpointTrajectory) -> tuple[int, int]:
        """Return how long an axis stands before its first count, and after its last one, by the slowest crystal."""
        periods_before_ns, periods_after_ns = (
            periods * trajectory.period_ns / NS_PER_S for periods in trajectory.still_periods
        )
        return self._device_ns(periods_before_ns, 1), self._device_ns(periods_after_ns, 1)

    def _between_ns(self, lowered: Cia402Lowered) -> int:
        """Return the tolerance of the duration: a drive that was stopped may stand between two counts, and reports the
        nearer one, so that its path is up to half a count longer or shorter than planned."""
        if lowered.shape is None:
            return 0
        counts_s = lowered.shape.velocity / float(self._options.velocity_units)
        return ceil(0.5 / counts_s * NS_PER_S)

    def _device_ns(self, seconds: float, sign: int) -> int:
        """Return a duration by the slowest (1) or fastest (-1) crystal."""
        exact = seconds * NS_PER_S * (1 + sign * self._options.clock_ppm * 1e-6)
        return ceil(exact) if sign > 0 else floor(exact)


def standing_ns(lowered: Cia402Lowered) -> int:
    """Return how long a stream continues at rest, for outputs that are switched after its end."""
    course = lowered.trajectory
    return 0 if course is None else (lowered.position_count - course.point_count) * course.period_ns
