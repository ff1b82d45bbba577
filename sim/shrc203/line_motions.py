"""Motions of program lines: their axes, distances, speeds and trigger."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from orchestrator.model.errors import TuttiError
from sim.core.devicetime import DeviceTime
from sim.shrc203.axis import Ready, RunKind, RunOrder, StageAxis
from sim.shrc203.continuous import ContinuousLeg
from sim.shrc203.drive import PathGenerator
from sim.shrc203.entries import ArcMove, LinearMove
from sim.shrc203.geometry import CollinearPoints
from sim.shrc203.grammar import MAX_PULSES
from sim.shrc203.inputs import InputScanner, OutputLevels
from sim.shrc203.launch import start_interpolation, start_travel
from sim.shrc203.origin import find_origin, go_to_zero
from sim.shrc203.path import SpeedTriple
from sim.shrc203.program_lines import KEEP_TRIGGER, ProgramLine, StoredPrograms
from sim.shrc203.registration import PositionRecords
from sim.shrc203.switches import MemorySwitches
from sim.shrc203.trigger import TIMER, TriggerOutput, TriggerSetting


class ProgramState(IntEnum):
    """Field pr of ?:L (L2106)."""

    NOT_EXECUTED = 0
    RUNNING = 1
    PAUSED = 2
    ONE_LINE = 3
    AXES_DIFFER = 4
    ERROR = 5
    UNEXPECTED_PATTERN = 6
    MOTOR_OFF = 7
    AXIS_BUSY = 8


class ProgramHost(Protocol):
    """Parts of the controller that a program uses."""

    @property
    def axes(self) -> Sequence[StageAxis]: ...

    time: DeviceTime
    drive: PathGenerator
    inputs: InputScanner
    outputs: OutputLevels
    trigger: TriggerOutput
    switches: MemorySwitches
    programs: StoredPrograms
    registrations: PositionRecords

    def ready_to_run(self, axis: StageAxis) -> bool: ...


class ProgramStop(TuttiError):
    """Stops the program with this state."""

    def __init__(self, state: ProgramState) -> None:
        super().__init__(state.name)
        self.state = state


@dataclass(frozen=True, slots=True)
class LineStart:
    """Device instant of a line's start, and what receives the ends of its motions."""

    at_ns: int
    ready: Ready


class LineMotions:
    """Starts what a program line requests."""

    def __init__(self, unit: ProgramHost) -> None:
        self._unit = unit

    def enabled_axes(self, line: ProgramLine) -> list[StageAxis]:
        """Return the enabled axes, checked as ?:L states (L2110-L2119)."""
        axes = [self._unit.axes[index] for index in line.axes]
        if line.pattern == "EH":
            axes += [axis for axis in self._unit.axes if axis not in axes]
        if not all(axis.controllable for axis in axes):
            raise ProgramStop(ProgramState.AXES_DIFFER)
        if not all(axis.excited for axis in axes):
            raise ProgramStop(ProgramState.MOTOR_OFF)
        if any(axis.is_busy for axis in axes):
            raise ProgramStop(ProgramState.AXIS_BUSY)
        if not all(self._unit.ready_to_run(axis) for axis in axes):
            raise ProgramStop(ProgramState.ERROR)
        return axes

    def speed_triple(self, axis: StageAxis, number: int) -> SpeedTriple:
        """Return the speeds that field s of a line selects."""
        return self._unit.switches.speed_triple(axis.index, number)

    def set_trigger(self, fields: dict[str, int]) -> None:
        """Set the trigger output as a line requests it."""
        mode = fields["tm"]
        if mode <= TIMER or "ta" in fields:
            axis = None if mode == TIMER else self._unit.axes[fields["ta"] - 1]
            self._unit.trigger.set_trigger(TriggerSetting(mode, axis, abs(fields["tv"])))
        elif mode != KEEP_TRIGGER:
            self._unit.trigger.set_trigger(None)

    def move_targets(self, line: ProgramLine, axes: Sequence[StageAxis]) -> list[int]:
        """Return the distance of each enabled axis, pls; empty for patterns that define it otherwise."""
        fields = line.fields
        if line.pattern in ("M", "K"):
            return [fields[f"ap{axis.index + 1}"] for axis in axes]
        if line.pattern == "A":
            return [fields[f"ap{axis.index + 1}"] - axis.position - axis.offset for axis in axes]
        if line.pattern != "PAV":
            return [0] * len(axes)
        targets: list[int] = []
        for axis in axes:
            record = self._unit.registrations.coordinates.get(fields[f"m{axis.index + 1}"])
            if record is None:
                raise ProgramStop(ProgramState.ERROR)
            targets.append(record[axis.index] - axis.position - axis.offset)
        return targets

    def _build_interpolation(
        self, line: ProgramLine, axes: list[StageAxis], targets: list[int]
    ) -> LinearMove | ArcMove:
        if any(axis.limit_on(sign, axis.position) for axis in axes for sign in (1, -1)):
            raise ProgramStop(ProgramState.ERROR)
        if line.pattern == "K":
            return LinearMove(tuple(axes), tuple(targets), None, from_pre=False)
        fields, mode = line.fields, line.fields["cm"]
        helix = line.pattern == "EH"
        form = mode // 2 + (3 if helix else 0)
        names = ("p1", "p2", "e1", "e2") if mode >= 4 else ("c1", "c2")
        return ArcMove(
            form=form,
            plane=(axes[0], axes[1]),
            linear=axes[2] if helix else None,
            ccw=bool(mode % 2),
            values=tuple(fields[name] for name in names),
            angle=line.angle if form in (1, 4) else None,
            rotations=fields.get("r", 1),
            rise=fields.get("hl", 0),
            triple=None,
            from_pre=False,
        )

    def start_motion(self, line: ProgramLine, axes: list[StageAxis], targets: list[int], order: LineStart) -> None:
        """Start the motion of a line on its axes."""
        at_ns, ready = order.at_ns, order.ready
        drive = self._unit.drive
        if line.pattern == "H":
            for axis in axes:
                find_origin(drive, axis, at_ns, ready)
            return
        number = line.fields["s"]
        if line.pattern in ("K", "E", "EH"):
            entry = self._build_interpolation(line, axes, targets)
            try:
                start_interpolation(drive, entry, self.speed_triple(entry.axes[0], number), at_ns, ready)
            except CollinearPoints:
                raise ProgramStop(ProgramState.ERROR) from None
            return
        for axis, target in zip(axes, targets, strict=True):
            triple = self.speed_triple(axis, number)
            if line.pattern == "Z":
                go_to_zero(drive, axis, triple, at_ns, ready)
            else:
                start_travel(drive, axis, target, RunOrder(triple, RunKind.MOVE, at_ns, ready))

    def continuous_legs(self, axis: StageAxis, lines: Sequence[ProgramLine]) -> list[ContinuousLeg]:
        """Return the legs of CM and CA lines, one after another."""
        legs: list[ContinuousLeg] = []
        position_here = axis.position + axis.offset
        for line in lines:
            value = line.fields[f"ap{axis.index + 1}"]
            target = position_here + value if line.pattern == "CM" else value
            if abs(target) > MAX_PULSES:
                raise ProgramStop(ProgramState.ERROR)
            legs.append(ContinuousLeg(target - position_here, self.speed_triple(axis, line.fields["s"])))
            position_here = target
        return legs
