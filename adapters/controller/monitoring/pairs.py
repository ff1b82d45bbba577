"""The watch of axes of two motors: how far these are apart, and the limit switches of the second one.

Both motors are stopped by one stop of the whole controller, so that one that is no longer geared stops as well.
"""

from collections.abc import Sequence

from adapters.contract import ControllerReading
from orchestrator.model.fleet import Controller
from orchestrator.model.pairs.rack import WATCH_HZ
from orchestrator.model.state import FaultReport

DEVIATION = "deviation"
_REMEDY = (
    "find what holds one of its motors, or has switched it off; then disable the axis, bring the beam square by hand, "
    "and enable and home it again"
)


class PairWatch:
    """The axes of two motors of one controller."""

    def __init__(self, config: Controller) -> None:
        self._axes = {name: axis for name, axis in config.axes.items() if axis.rack is not None}
        moving_hz = config.state.moving_hz
        self.moving_hz = max(moving_hz, WATCH_HZ) if self._axes else moving_hz
        """How often the controller is read while it moves."""

    @property
    def has_pairs(self) -> bool:
        """Whether there is any such axis."""
        return bool(self._axes)

    def find_deviations(self, reading: ControllerReading) -> list[FaultReport]:
        """A fault for each axis whose motors are too far apart."""
        faults: list[FaultReport] = []
        for name, axis in self._axes.items():
            axis_reading = reading.axes[name]
            if axis_reading.second is None or axis.max_deviation is None:
                continue
            first, second = axis.to_unit(axis_reading.actual_counts), axis.to_unit(axis_reading.second.actual_counts)
            if abs(second - first) > axis.max_deviation:
                motors = f"motor {axis.motors[0]} is at {first:.4g}, {axis.motors[1]} at {second:.4g} {axis.unit}"
                text = (
                    f"the motors of axis {name} are {abs(second - first):.4g} {axis.unit} apart, and "
                    f"{axis.max_deviation:g} are allowed: {motors}"
                )
                faults.append(FaultReport(code=DEVIATION, text=text, remedy=_REMEDY, axis=name))
        return faults

    def explain_stop(
        self, last_reading: ControllerReading | None, reading: ControllerReading, faults: Sequence[FaultReport]
    ) -> str | None:
        """Why a controller that moves must be stopped: a deviation, or a second motor that has run into its limit
        switch, which its gearing does not regard; None: it need not."""
        for name in self._axes:
            axis_reading = reading.axes[name]
            if not axis_reading.moving:
                continue
            deviation = next((fault.text for fault in faults if fault.code == DEVIATION and fault.axis == name), None)
            if deviation is not None:
                return deviation
            last = None if last_reading is None else last_reading.axes[name].second
            limit = "none" if axis_reading.second is None else axis_reading.second.limit
            if limit not in ("none", "none" if last is None else last.limit):
                return f"the second motor of axis {name} has run into its {limit} limit switch"
        return None
