"""Running a stored program (section 13.3)."""

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Protocol

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Timer
from sim.core.devicetime import DeviceTime
from sim.shrc203.axis import StageAxis
from sim.shrc203.continuous import CONTINUOUS_LINES, ContinuousLeg, continuous_path
from sim.shrc203.drive import EndCause, PathGenerator, PathRun, RunKind
from sim.shrc203.entries import ArcMove, LinearMove
from sim.shrc203.geometry import CollinearPoints
from sim.shrc203.grammar import MAX_PULSES
from sim.shrc203.inputs import InputScanner, OutputLevels
from sim.shrc203.launch import start_interpolation, start_travel
from sim.shrc203.line import Reply
from sim.shrc203.origin import find_origin, go_to_zero, set_zero
from sim.shrc203.path import SpeedTriple
from sim.shrc203.program_lines import KEEP_TRIGGER, LINES, NESTS, NONE, ONE_SHOT, Program, ProgramLine, StoredPrograms
from sim.shrc203.registration import PositionRecords
from sim.shrc203.switches import MemorySwitches
from sim.shrc203.trigger import TIMER, TriggerOutput, TriggerSetting

_LINE_NS = NS_PER_MS
_TENTH_NS = NS_PER_S // 10


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
    """Parts of the controller that a program uses in addition to its axes."""

    switches: MemorySwitches
    programs: StoredPrograms
    registrations: PositionRecords

    def ready_to_run(self, axis: StageAxis) -> bool: ...


class _ProgramStop(Exception):
    """Stops the program with this state."""

    def __init__(self, state: ProgramState) -> None:
        super().__init__(state.name)
        self.state = state


class ProgramRun:
    """The running program, if any."""

    def __init__(
        self,
        axes: Sequence[StageAxis],
        time: DeviceTime,
        drive: PathGenerator,
        inputs: InputScanner,
        outputs: OutputLevels,
        trigger: TriggerOutput,
        unit: ProgramHost,
    ) -> None:
        self._axes = axes
        self._time = time
        self._drive = drive
        self._inputs = inputs
        self._outputs = outputs
        self._trigger = trigger
        self._unit = unit
        self._program: Program = {}
        self._timers: list[Timer] = []
        self._pending: set[StageAxis] = set()
        """Axes that the present line still waits for."""
        self._pausing = False
        self._epoch = 0
        """Counts starts and stops: callbacks of an earlier epoch are ignored."""
        self._loop_lines: list[int] = [0] * NESTS
        self.state = ProgramState.NOT_EXECUTED
        self.line = 1
        self.loops: list[int] = [0] * NESTS
        self.reply: Reply | None = None
        self.report_end = False
        self.report_triggers = False

    @property
    def is_running(self) -> bool:
        return self.state in (ProgramState.RUNNING, ProgramState.ONE_LINE)

    # Commands

    def start_program(self) -> None:
        """P:S, from the first line."""
        self._begin_run()
        self.line = 1
        self._start_line(ProgramState.RUNNING)

    def run_one_line(self) -> None:
        """P:O: one line, then pause (L5559)."""
        if self.state is not ProgramState.PAUSED:
            self._begin_run()
            self.line = 1
        self._start_line(ProgramState.ONE_LINE)

    def pause_program(self) -> None:
        """P:U0: pause after the line that is being executed."""
        self._pausing = self.is_running

    def resume_program(self) -> None:
        """P:U1."""
        self._pausing = False
        if self.state is ProgramState.PAUSED:
            self._start_line(ProgramState.RUNNING)

    def stop_program(self) -> None:
        """P:E: decelerate the axes and end the program."""
        if self.is_running or self.state is ProgramState.PAUSED:
            self._end_run(ProgramState.NOT_EXECUTED)
            for axis in self._axes:
                if axis.run is not None:
                    self._drive.stop_run(axis.run)

    def fail_program(self) -> None:
        """Handle a stop of the axes from outside the program."""
        if self.is_running or self.state is ProgramState.PAUSED:
            self._end_run(ProgramState.ERROR)

    def clear_run(self) -> None:
        """Power-down."""
        self._end_run(ProgramState.NOT_EXECUTED)
        self.line, self.loops = 1, [0] * NESTS
        self.reply, self.report_end, self.report_triggers = None, False, False

    # Running

    def _begin_run(self) -> None:
        self._program = self._unit.programs.current_program
        self.loops = [0] * NESTS
        self._loop_lines = [0] * NESTS

    def _start_line(self, state: ProgramState) -> None:
        self.state, self._pausing = state, False
        self._epoch += 1
        self._trigger.set_listener(self._report_trigger if self.report_triggers else None)
        self._call_at(self._time.now_ns(), self._execute_line)

    def _end_run(self, state: ProgramState) -> None:
        self.state, self._pausing = state, False
        self._epoch += 1
        self._cancel_timers()
        self._inputs.cancel_wait(self)
        self._pending.clear()
        self._trigger.set_listener(None)

    def _cancel_timers(self) -> None:
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()

    def _call_at(self, at_ns: int, action: Callable[[int], None]) -> None:
        self._timers.append(self._time.call_at(at_ns, lambda: action(at_ns)))

    def _report_trigger(self) -> None:
        if self.reply is not None:
            self.reply("TRIG")

    def _execute_line(self, at_ns: int) -> None:
        self._timers.clear()
        while self.line <= LINES and self._program.get(self.line, NONE) is NONE:
            later = [number for number in self._program if number > self.line]
            self.line = min(later, default=LINES + 1)
        if self.line > LINES:
            self.line = LINES
            self._complete_line()
            return
        try:
            self._run_line(self._program[self.line], at_ns)
        except _ProgramStop as stop:
            self._end_run(stop.state)

    def _complete_line(self) -> None:
        reply = self.reply if self.report_end else None
        self._end_run(ProgramState.NOT_EXECUTED)
        if reply is not None:
            reply("COMP")

    def _next_line(self, at_ns: int, line: int) -> None:
        """Finish the present line."""
        self.line = line
        if self._pausing or self.state is ProgramState.ONE_LINE:
            self.state, self._pausing = ProgramState.PAUSED, False
            self._trigger.set_listener(None)
        else:
            self._call_at(at_ns + _LINE_NS, self._execute_line)

    def _run_line(self, line: ProgramLine, at_ns: int) -> None:
        fields = line.fields
        match line.pattern:
            case "END":
                self._complete_line()
            case "F":
                nest = fields["ll"] - 1
                self.loops[nest], self._loop_lines[nest] = fields["lv"], self.line
                self._next_line(at_ns, self.line + 1)
            case "N":
                self._loop_end(fields["ll"] - 1, at_ns)
            case "INPUT":
                epoch = self._epoch
                self._inputs.wait_for_pattern(
                    self, fields["i"], lambda seen_ns: self._handle_input_match(epoch, seen_ns)
                )
            case "R":
                for axis in self._enabled_axes(line):
                    set_zero(axis)
                self._next_line(at_ns, self.line + 1)
            case "CM" | "CA":
                self._run_continuous(line, at_ns)
            case _:
                self._start_move(line, at_ns)

    def _handle_input_match(self, epoch: int, at_ns: int) -> None:
        if epoch == self._epoch:
            self._next_line(at_ns, self.line + 1)

    def _loop_end(self, nest: int, at_ns: int) -> None:
        if not self._loop_lines[nest]:
            raise _ProgramStop(ProgramState.UNEXPECTED_PATTERN)
        self.loops[nest] -= 1
        if self.loops[nest] > 0:
            self._next_line(at_ns, self._loop_lines[nest] + 1)
        else:
            self._loop_lines[nest] = 0
            self._next_line(at_ns, self.line + 1)

    def _enabled_axes(self, line: ProgramLine) -> list[StageAxis]:
        """Return the enabled axes, checked as ?:L states (L2110-L2119)."""
        axes = [self._axes[index] for index in line.axes]
        if line.pattern == "EH":
            axes += [axis for axis in self._axes if axis not in axes]
        if not all(axis.controllable for axis in axes):
            raise _ProgramStop(ProgramState.AXES_DIFFER)
        if not all(axis.excited for axis in axes):
            raise _ProgramStop(ProgramState.MOTOR_OFF)
        if any(axis.is_busy for axis in axes):
            raise _ProgramStop(ProgramState.AXIS_BUSY)
        if not all(self._unit.ready_to_run(axis) for axis in axes):
            raise _ProgramStop(ProgramState.ERROR)
        return axes

    def _speed_triple(self, axis: StageAxis, number: int) -> SpeedTriple:
        return self._unit.switches.speed_triple(axis.index, number)

    def _set_trigger(self, fields: dict[str, int]) -> None:
        mode = fields["tm"]
        if mode <= TIMER or "ta" in fields:
            axis = None if mode == TIMER else self._axes[fields["ta"] - 1]
            self._trigger.set_trigger(TriggerSetting(mode, axis, abs(fields["tv"])))
        elif mode != KEEP_TRIGGER:
            self._trigger.set_trigger(None)

    def _start_move(self, line: ProgramLine, at_ns: int) -> None:
        axes, fields = self._enabled_axes(line), line.fields
        targets = self._move_targets(line, axes)
        self._outputs.set_levels(fields["o"])
        self._set_trigger(fields)
        epoch = self._epoch
        self._pending = set(axes)

        def handle_move_end(run: PathRun, ready_ns: int, cause: EndCause) -> None:
            if epoch == self._epoch:
                self._handle_positioned(run, ready_ns, cause, line)

        if line.pattern == "H":
            for axis in axes:
                find_origin(self._drive, axis, at_ns, handle_move_end)
            return
        number = fields["s"]
        if line.pattern in ("K", "E", "EH"):
            entry = self._build_interpolation(line, axes, targets)
            try:
                start_interpolation(
                    self._drive, entry, self._speed_triple(entry.axes[0], number), at_ns, handle_move_end
                )
            except CollinearPoints:
                raise _ProgramStop(ProgramState.ERROR) from None
            return
        for axis, target in zip(axes, targets, strict=True):
            triple = self._speed_triple(axis, number)
            if line.pattern == "Z":
                go_to_zero(self._drive, axis, triple, at_ns, handle_move_end)
            else:
                start_travel(self._drive, axis, target, triple, RunKind.MOVE, at_ns, handle_move_end)

    def _move_targets(self, line: ProgramLine, axes: Sequence[StageAxis]) -> list[int]:
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
                raise _ProgramStop(ProgramState.ERROR)
            targets.append(record[axis.index] - axis.position - axis.offset)
        return targets

    def _build_interpolation(
        self, line: ProgramLine, axes: list[StageAxis], targets: list[int]
    ) -> LinearMove | ArcMove:
        if any(axis.limit_on(sign, axis.position) for axis in axes for sign in (1, -1)):
            raise _ProgramStop(ProgramState.ERROR)
        if line.pattern == "K":
            return LinearMove(tuple(axes), tuple(targets), None, False)
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

    def _handle_positioned(self, run: PathRun, at_ns: int, cause: EndCause, line: ProgramLine) -> None:
        if cause is not EndCause.END:
            self._end_run(ProgramState.ERROR)
            return
        self._pending.difference_update(track.axis for track in run.tracks)
        if self._pending:
            return
        if line.fields.get("tm") == ONE_SHOT:
            self._trigger.fire_pulse()
        self._wait_and_continue(line, at_ns, self.line + 1)

    def _wait_and_continue(self, line: ProgramLine, at_ns: int, following: int) -> None:
        """Wait for the line's time w, then continue with the next line (decision 48)."""
        wait_ns = line.fields["w"] * _TENTH_NS
        if wait_ns:
            self._call_at(at_ns + wait_ns, lambda then_ns: self._next_line(then_ns, following))
        else:
            self._next_line(at_ns, following)

    # Continuous operation

    def _run_continuous(self, first: ProgramLine, at_ns: int) -> None:
        """Run the CM and CA lines from here on as one motion through their points (L5792)."""
        axis = self._enabled_axes(first)[0]
        batch: list[tuple[int, ProgramLine]] = []
        number = self.line
        while len(batch) < (1 if self.state is ProgramState.ONE_LINE else CONTINUOUS_LINES):
            line = self._program.get(number, NONE)
            if line.pattern not in ("CM", "CA") or line.axes != first.axes:
                break
            batch.append((number, line))
            number += 1
        legs: list[ContinuousLeg] = []
        here = axis.position + axis.offset
        for _, line in batch:
            value = line.fields[f"ap{axis.index + 1}"]
            target = here + value if line.pattern == "CM" else value
            if abs(target) > MAX_PULSES:
                raise _ProgramStop(ProgramState.ERROR)
            legs.append(ContinuousLeg(target - here, self._speed_triple(axis, line.fields["s"])))
            here = target
        path, passings = continuous_path(legs)
        epoch, last = self._epoch, batch[-1][1]
        self._trigger.set_trigger(None)
        self._outputs.set_levels(first.fields["o"])
        for index, passing in enumerate(passings[:-1]):
            then_ns = at_ns + round(passing * NS_PER_S)
            self._call_at(then_ns, lambda _, at=index: self._pass_point(batch[at + 1]))

        def handle_path_end(run: PathRun, ready_ns: int, cause: EndCause) -> None:
            if epoch != self._epoch:
                return
            if cause is not EndCause.END:
                self._end_run(ProgramState.ERROR)
                return
            self._trigger.fire_pulse()
            self._timers.clear()
            self._wait_and_continue(last, ready_ns, batch[-1][0] + 1)

        self._drive.start_run([(axis, path)], legs[-1].triple, RunKind.MOVE, at_ns, handle_path_end)

    def _pass_point(self, following: tuple[int, ProgramLine]) -> None:
        """Handle a passing point: trigger, then the next line's number and outputs."""
        self._trigger.fire_pulse()
        self.line = following[0]
        self._outputs.set_levels(following[1].fields["o"])
