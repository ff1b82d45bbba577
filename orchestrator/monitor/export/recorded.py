"""What an export takes from a recording: readings of axes, plans, events, the report."""

from collections import defaultdict
from dataclasses import dataclass, field
from math import nan
from typing import NamedTuple

from pydantic import ValidationError

from orchestrator.model.operation.recording import JobPoints, RecordedTriggers, StepSamples
from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.model.report import JobReport, PointRecord, StepRecording
from orchestrator.model.state import ControllerEvent, ControllerState
from orchestrator.monitor.recording.reader import Recording


class RecordedReading(NamedTuple):
    """One reading of an axis. fleet_ns: when the answer to the poll had arrived; utc_ns: the same instant.

    The others as in `state.AxisState`, with the mode of its controller. Of a virtual axis the mode is `virtual`, and
    `commanded` is where it would be at the commanded positions of its real axes; it has no motor and no counts (NaN).
    """

    fleet_ns: int
    utc_ns: int
    position: float
    commanded: float
    velocity: float
    motor_position: float
    raw_counts: float
    unit: str
    moving: bool
    mode: str


@dataclass(slots=True)
class RecordedRun:
    """The contents of a recording. readings: by axis, in order. unread: messages that were not valid."""

    readings: dict[str, list[RecordedReading]] = field(default_factory=lambda: defaultdict(list))
    plans: list[StepRecording] = field(default_factory=list[StepRecording])
    events: list[ControllerEvent] = field(default_factory=list[ControllerEvent])
    samples: list[StepSamples] = field(default_factory=list[StepSamples])
    triggers: list[RecordedTriggers] = field(default_factory=list[RecordedTriggers])
    points: list[PointRecord] = field(default_factory=list[PointRecord])
    report: JobReport | None = None
    unread: int = 0

    @property
    def units(self) -> dict[str, str]:
        """The units of the axes that were read."""
        return {axis: readings[-1].unit for axis, readings in self.readings.items() if readings}

    @property
    def utc_offset_ns(self) -> int:
        """UTC less fleet time, ns; 0 without a reading."""
        first = next((reading[0] for reading in self.readings.values() if reading), None)
        return 0 if first is None else first.utc_ns - first.fleet_ns


def load_run(recording: Recording) -> RecordedRun:
    """Read a recording for an export. Raises `RecordingUnreadable`."""
    run = RecordedRun()
    for message in recording.read_messages():
        kind, leaf = message.key.partition("/")[0], message.key.rpartition("/")[2]
        try:
            if not message.valid:
                run.unread += 1
            elif (kind, leaf) == ("ctl", "state"):
                _add_state(run, ControllerState.read_message(message.payload), message.published_ns)
            elif (kind, leaf) == ("virtual", "state"):
                _add_virtual_state(run, VirtualState.read_message(message.payload), message.published_ns)
            elif (kind, leaf) == ("ctl", "event"):
                run.events.append(ControllerEvent.read_message(message.payload))
            elif (kind, leaf) == ("job", "plan"):
                run.plans.append(StepRecording.read_message(message.payload))
            elif (kind, leaf) == ("job", "samples"):
                run.samples.append(StepSamples.read_message(message.payload))
            elif (kind, leaf) == ("job", "triggers"):
                run.triggers.append(RecordedTriggers.read_message(message.payload))
            elif (kind, leaf) == ("job", "points"):
                run.points += JobPoints.read_message(message.payload).rows
            elif (kind, leaf) == ("job", "report"):
                run.report = JobReport.read_message(message.payload)
        except ValidationError:  # of another version
            run.unread += 1
    return run


def _add_state(run: RecordedRun, state: ControllerState, utc_ns: int) -> None:
    if state.read_fleet_ns is None:
        return
    for name, axis in state.axes.items():
        readings = run.readings[f"{state.controller}.{name}"]
        # A state is also published without a new reading.
        if not readings or readings[-1].fleet_ns < state.read_fleet_ns:
            readings.append(
                RecordedReading(
                    fleet_ns=state.read_fleet_ns,
                    utc_ns=utc_ns,
                    position=axis.position,
                    commanded=axis.commanded,
                    velocity=axis.velocity,
                    motor_position=axis.motor_position,
                    raw_counts=axis.raw_counts,
                    unit=axis.unit,
                    moving=axis.moving,
                    mode=state.mode,
                )
            )


def _add_virtual_state(run: RecordedRun, state: VirtualState, utc_ns: int) -> None:
    if state.fleet_ns is None:
        return
    for name, axis in state.axes.items():
        readings = run.readings[f"{state.group}.{name}"]
        if not readings or readings[-1].fleet_ns < state.fleet_ns:
            readings.append(
                RecordedReading(
                    fleet_ns=state.fleet_ns,
                    utc_ns=utc_ns,
                    position=axis.position,
                    commanded=axis.target,
                    velocity=axis.velocity,
                    motor_position=nan,
                    raw_counts=nan,
                    unit=axis.unit,
                    moving=state.moving,
                    mode="virtual",
                )
            )
