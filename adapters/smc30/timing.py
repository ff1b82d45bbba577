"""When a step ends, by its start, its duration and the crystal of its controller; and what its motion tells of that."""

from adapters.contract import HostInterval
from adapters.smc30.lowering import LINES_BEFORE
from adapters.smc30.options import Smc30DriverOptions
from adapters.smc30.step import LoadedStep
from adapters.toolkit.host_start import MoverTools
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US

_OVERDUE_NS = NS_PER_S  # a motion that ends later than this is blocked, or has never begun


class Smc30Timing:
    """The bounds of the motions of one controller, ns of the host's clock."""

    def __init__(self, options: Smc30DriverOptions, tools: MoverTools) -> None:
        self._options = options
        self._clock = tools.clock
        self._crystal = tools.crystal

    def duration_bounds_ns(self, move: LoadedStep) -> tuple[int, int]:
        """Return the shortest and longest duration of the motion by everything known about the crystal."""
        shape = move.lowered.shape
        return self._crystal.crystal_rate.host_duration_ns(
            0.0 if shape is None else shape.duration_s, self._clock.now_ns()
        )

    def end_interval(self, move: LoadedStep, last_busy_ns: int, ready_ns: int) -> HostInterval:
        """Return the interval of the end: from its start and its duration, within the error of the crystal, and before
        the answer that it is ready.

        The motion may be followed by more program lines; then the busy state gives no information.
        """
        least_ns, most_ns = self.duration_bounds_ns(move)
        earliest_ns = move.start.earliest_ns + least_ns - self._gap_spread_ns(move)
        latest_ns = move.start.latest_ns + most_ns + self._gap_spread_ns(move)
        if move.lowered.drive is None:
            earliest_ns = max(earliest_ns, last_busy_ns)
        latest_ns = min(latest_ns, ready_ns)
        return HostInterval(min(earliest_ns, latest_ns), latest_ns)

    def program_excess_ns(self, move: LoadedStep) -> int:
        """Return how much longer than the motion its program may take."""
        hold_times = [int(line[1:]) for line in move.lowered.program if line.startswith("D") and move.lowered.drive]
        return _OVERDUE_NS + sum(hold_times) * 10 * NS_PER_MS

    def learn_crystal(self, move: LoadedStep, ready_ns: int) -> None:
        """Learn the crystal's rate and the start delay from a motion that has ended as planned."""
        if move.timed is None or move.stopped_ns is not None:
            return
        lowered_step = move.lowered
        move.timed.mark_ended(ready_ns)
        program_ns = sum(lowered_step.program_ns) // 2
        answered_ns = None if move.answered_ns is None else move.answered_ns + program_ns
        # Without the delay, which is not the same in all programs.
        began_ns = move.arrived_ns + program_ns - LINES_BEFORE * self._options.line_us * NS_PER_US
        self._crystal.learn_from_move(move.timed, began_ns, answered_ns, self._clock.now_ns(), move.start.late_ns)

    def _gap_spread_ns(self, move: LoadedStep) -> int:
        shape = move.lowered.shape
        return 0 if shape is None else 2 * (len(shape.parts) - 1) * self._options.line_spread_us * NS_PER_US
