"""Running a stored program (section 13.3)."""

from collections.abc import Callable

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, ClockTimer
from sim.shrc203.axis import EndCause, PathRun, RunKind, RunOrder, StageAxis
from sim.shrc203.continuous import CONTINUOUS_LINES, continuous_path
from sim.shrc203.line import Reply
from sim.shrc203.line_motions import LineMotions, LineStart, ProgramHost, ProgramState, ProgramStop
from sim.shrc203.origin import set_zero
from sim.shrc203.program_lines import LINES, NESTS, NONE, ONE_SHOT, Program, ProgramLine

_LINE_NS = NS_PER_MS
_TENTH_NS = NS_PER_S // 10


class ProgramRun:
    """The running program, if any."""

    def __init__(self, unit: ProgramHost) -> None:
        self._axes = unit.axes
        self._time = unit.time
        self._drive = unit.drive
        self._inputs = unit.inputs
        self._outputs = unit.outputs
        self._trigger = unit.trigger
        self._unit = unit
        self._motions = LineMotions(unit)
        self._program: Program = {}
        self._timers: list[ClockTimer] = []
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
            later_lines = [number for number in self._program if number > self.line]
            self.line = min(later_lines, default=LINES + 1)
        if self.line > LINES:
            self.line = LINES
            self._complete_line()
            return
        try:
            self._run_line(self._program[self.line], at_ns)
        except ProgramStop as stop:
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
                for axis in self._motions.enabled_axes(line):
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
            raise ProgramStop(ProgramState.UNEXPECTED_PATTERN)
        self.loops[nest] -= 1
        if self.loops[nest] > 0:
            self._next_line(at_ns, self._loop_lines[nest] + 1)
        else:
            self._loop_lines[nest] = 0
            self._next_line(at_ns, self.line + 1)

    def _start_move(self, line: ProgramLine, at_ns: int) -> None:
        axes, fields = self._motions.enabled_axes(line), line.fields
        targets = self._motions.move_targets(line, axes)
        self._outputs.set_levels(fields["o"])
        self._motions.set_trigger(fields)
        epoch = self._epoch
        self._pending = set(axes)

        def handle_move_end(run: PathRun, ready_ns: int, cause: EndCause) -> None:
            if epoch == self._epoch:
                self._handle_positioned(run, ready_ns, cause, line)

        self._motions.start_motion(line, axes, targets, LineStart(at_ns, handle_move_end))

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
        axis = self._motions.enabled_axes(first)[0]
        batch: list[tuple[int, ProgramLine]] = []
        number = self.line
        while len(batch) < (1 if self.state is ProgramState.ONE_LINE else CONTINUOUS_LINES):
            line = self._program.get(number, NONE)
            if line.pattern not in ("CM", "CA") or line.axes != first.axes:
                break
            batch.append((number, line))
            number += 1
        legs = self._motions.continuous_legs(axis, [line for _, line in batch])
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

        self._drive.start_run([(axis, path)], RunOrder(legs[-1].triple, RunKind.MOVE, at_ns, handle_path_end))

    def _pass_point(self, following: tuple[int, ProgramLine]) -> None:
        """Handle a passing point: trigger, then the next line's number and outputs."""
        self._trigger.fire_pulse()
        self.line = following[0]
        self._outputs.set_levels(following[1].fields["o"])
