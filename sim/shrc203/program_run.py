"""Running a stored program (section 13.3)."""

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Protocol

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Timer
from sim.core.devicetime import DeviceTime
from sim.shrc203.axis import Axis
from sim.shrc203.continuous import CONTINUOUS_LINES, Leg, continuous
from sim.shrc203.drive import Cause, Drive, Kind, Run
from sim.shrc203.entries import Arc, Line
from sim.shrc203.geometry import Collinear
from sim.shrc203.grammar import MAX_PULSES
from sim.shrc203.inputs import Inputs, Outputs
from sim.shrc203.launch import interpolate, travel
from sim.shrc203.line import Reply
from sim.shrc203.origin import find_origin, go_to_zero, set_zero
from sim.shrc203.path import Triple
from sim.shrc203.program_lines import KEEP_TRIGGER, LINES, NESTS, NONE, ONE_SHOT, Program, ProgramLine, Programs
from sim.shrc203.registration import Registrations
from sim.shrc203.switches import Switches
from sim.shrc203.trigger import TIMER, Setting, Trigger

_LINE_NS = NS_PER_MS
_TENTH_NS = NS_PER_S // 10


class State(IntEnum):
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


class Surroundings(Protocol):
    """What a program needs of the unit besides its axes."""

    switches: Switches
    programs: Programs
    registrations: Registrations

    def ready_to_run(self, axis: Axis) -> bool: ...


class _Stop(Exception):
    """The program stops, with this state."""

    def __init__(self, state: State) -> None:
        super().__init__(state.name)
        self.state = state


class ProgramRun:
    """The program that is running, if any."""

    def __init__(
        self,
        axes: Sequence[Axis],
        time: DeviceTime,
        drive: Drive,
        inputs: Inputs,
        outputs: Outputs,
        trigger: Trigger,
        unit: Surroundings,
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
        self._pending: set[Axis] = set()
        """Axes that the present line still waits for."""
        self._pausing = False
        self._epoch = 0
        """Counts starts and stops: what an earlier one has set going is not listened to."""
        self._loop_lines: list[int] = [0] * NESTS
        self.state = State.NOT_EXECUTED
        self.line = 1
        self.loops: list[int] = [0] * NESTS
        self.reply: Reply | None = None
        self.report_end = False
        self.report_triggers = False

    @property
    def running(self) -> bool:
        return self.state in (State.RUNNING, State.ONE_LINE)

    # Commands

    def start(self) -> None:
        """P:S, from the first line."""
        self._begin()
        self.line = 1
        self._start_line(State.RUNNING)

    def one_line(self) -> None:
        """P:O: one line, then pause (L5559)."""
        if self.state is not State.PAUSED:
            self._begin()
            self.line = 1
        self._start_line(State.ONE_LINE)

    def pause(self) -> None:
        """P:U0: pauses after the line that is being executed."""
        self._pausing = self.running

    def resume(self) -> None:
        """P:U1."""
        self._pausing = False
        if self.state is State.PAUSED:
            self._start_line(State.RUNNING)

    def stop(self) -> None:
        """P:E: axes decelerate and the program is over."""
        if self.running or self.state is State.PAUSED:
            self._over(State.NOT_EXECUTED)
            for axis in self._axes:
                if axis.run is not None:
                    self._drive.stop(axis.run)

    def fail(self) -> None:
        """Something stopped the axes under the program."""
        if self.running or self.state is State.PAUSED:
            self._over(State.ERROR)

    def clear(self) -> None:
        """Power-down."""
        self._over(State.NOT_EXECUTED)
        self.line, self.loops = 1, [0] * NESTS
        self.reply, self.report_end, self.report_triggers = None, False, False

    # Running

    def _begin(self) -> None:
        self._program = self._unit.programs.current
        self.loops = [0] * NESTS
        self._loop_lines = [0] * NESTS

    def _start_line(self, state: State) -> None:
        self.state, self._pausing = state, False
        self._epoch += 1
        self._trigger.watch(self._triggered if self.report_triggers else None)
        self._at(self._time.now_ns(), self._execute)

    def _over(self, state: State) -> None:
        self.state, self._pausing = state, False
        self._epoch += 1
        self._cancel_timers()
        self._inputs.forget(self)
        self._pending.clear()
        self._trigger.watch(None)

    def _cancel_timers(self) -> None:
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()

    def _at(self, at_ns: int, action: Callable[[int], None]) -> None:
        self._timers.append(self._time.call_at(at_ns, lambda: action(at_ns)))

    def _triggered(self) -> None:
        if self.reply is not None:
            self.reply("TRIG")

    def _execute(self, at_ns: int) -> None:
        self._timers.clear()
        while self.line <= LINES and self._program.get(self.line, NONE) is NONE:
            later = [number for number in self._program if number > self.line]
            self.line = min(later, default=LINES + 1)
        if self.line > LINES:
            self.line = LINES
            self._complete()
            return
        try:
            self._run_line(self._program[self.line], at_ns)
        except _Stop as stop:
            self._over(stop.state)

    def _complete(self) -> None:
        reply = self.reply if self.report_end else None
        self._over(State.NOT_EXECUTED)
        if reply is not None:
            reply("COMP")

    def _next(self, at_ns: int, line: int) -> None:
        """The present line is done."""
        self.line = line
        if self._pausing or self.state is State.ONE_LINE:
            self.state, self._pausing = State.PAUSED, False
            self._trigger.watch(None)
        else:
            self._at(at_ns + _LINE_NS, self._execute)

    def _run_line(self, line: ProgramLine, at_ns: int) -> None:
        fields = line.fields
        match line.pattern:
            case "END":
                self._complete()
            case "F":
                nest = fields["ll"] - 1
                self.loops[nest], self._loop_lines[nest] = fields["lv"], self.line
                self._next(at_ns, self.line + 1)
            case "N":
                self._loop_end(fields["ll"] - 1, at_ns)
            case "INPUT":
                epoch = self._epoch
                self._inputs.wait(self, fields["i"], lambda seen_ns: self._seen(epoch, seen_ns))
            case "R":
                for axis in self._enabled(line):
                    set_zero(axis)
                self._next(at_ns, self.line + 1)
            case "CM" | "CA":
                self._run_continuous(line, at_ns)
            case _:
                self._move(line, at_ns)

    def _seen(self, epoch: int, at_ns: int) -> None:
        if epoch == self._epoch:
            self._next(at_ns, self.line + 1)

    def _loop_end(self, nest: int, at_ns: int) -> None:
        if not self._loop_lines[nest]:
            raise _Stop(State.UNEXPECTED_PATTERN)
        self.loops[nest] -= 1
        if self.loops[nest] > 0:
            self._next(at_ns, self._loop_lines[nest] + 1)
        else:
            self._loop_lines[nest] = 0
            self._next(at_ns, self.line + 1)

    def _enabled(self, line: ProgramLine) -> list[Axis]:
        """The enabled axes, checked as ?:L tells (L2110-L2119)."""
        axes = [self._axes[index] for index in line.axes]
        if line.pattern == "EH":
            axes += [axis for axis in self._axes if axis not in axes]
        if not all(axis.controllable for axis in axes):
            raise _Stop(State.AXES_DIFFER)
        if not all(axis.excited for axis in axes):
            raise _Stop(State.MOTOR_OFF)
        if any(axis.busy for axis in axes):
            raise _Stop(State.AXIS_BUSY)
        if not all(self._unit.ready_to_run(axis) for axis in axes):
            raise _Stop(State.ERROR)
        return axes

    def _speed(self, axis: Axis, number: int) -> Triple:
        return self._unit.switches.speed(axis.index, number)

    def _set_trigger(self, fields: dict[str, int]) -> None:
        mode = fields["tm"]
        if mode <= TIMER or "ta" in fields:
            axis = None if mode == TIMER else self._axes[fields["ta"] - 1]
            self._trigger.set(Setting(mode, axis, abs(fields["tv"])))
        elif mode != KEEP_TRIGGER:
            self._trigger.set(None)

    def _move(self, line: ProgramLine, at_ns: int) -> None:
        axes, fields = self._enabled(line), line.fields
        targets = self._targets(line, axes)
        self._outputs.set(fields["o"])
        self._set_trigger(fields)
        epoch = self._epoch
        self._pending = set(axes)

        def ready(run: Run, ready_ns: int, cause: Cause) -> None:
            if epoch == self._epoch:
                self._positioned(run, ready_ns, cause, line)

        if line.pattern == "H":
            for axis in axes:
                find_origin(self._drive, axis, at_ns, ready)
            return
        number = fields["s"]
        if line.pattern in ("K", "E", "EH"):
            entry = self._interpolation(line, axes, targets)
            try:
                interpolate(self._drive, entry, self._speed(entry.axes[0], number), at_ns, ready)
            except Collinear:
                raise _Stop(State.ERROR) from None
            return
        for axis, target in zip(axes, targets, strict=True):
            triple = self._speed(axis, number)
            if line.pattern == "Z":
                go_to_zero(self._drive, axis, triple, at_ns, ready)
            else:
                travel(self._drive, axis, target, triple, Kind.MOVE, at_ns, ready)

    def _targets(self, line: ProgramLine, axes: Sequence[Axis]) -> list[int]:
        """How far each enabled axis goes, pls; empty for patterns that say it otherwise."""
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
                raise _Stop(State.ERROR)
            targets.append(record[axis.index] - axis.position - axis.offset)
        return targets

    def _interpolation(self, line: ProgramLine, axes: list[Axis], targets: list[int]) -> Line | Arc:
        if any(axis.limit_on(sign, axis.position) for axis in axes for sign in (1, -1)):
            raise _Stop(State.ERROR)
        if line.pattern == "K":
            return Line(tuple(axes), tuple(targets), None, False)
        fields, mode = line.fields, line.fields["cm"]
        helix = line.pattern == "EH"
        form = mode // 2 + (3 if helix else 0)
        names = ("p1", "p2", "e1", "e2") if mode >= 4 else ("c1", "c2")
        return Arc(
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

    def _positioned(self, run: Run, at_ns: int, cause: Cause, line: ProgramLine) -> None:
        if cause is not Cause.END:
            self._over(State.ERROR)
            return
        self._pending.difference_update(track.axis for track in run.tracks)
        if self._pending:
            return
        if line.fields.get("tm") == ONE_SHOT:
            self._trigger.fire()
        self._wait_and_go_on(line, at_ns, self.line + 1)

    def _wait_and_go_on(self, line: ProgramLine, at_ns: int, following: int) -> None:
        """The line's wait w, then the next line (decision 48)."""
        wait_ns = line.fields["w"] * _TENTH_NS
        if wait_ns:
            self._at(at_ns + wait_ns, lambda then_ns: self._next(then_ns, following))
        else:
            self._next(at_ns, following)

    # Continuous operation

    def _run_continuous(self, first: ProgramLine, at_ns: int) -> None:
        """The CM and CA lines from here on as one motion through their points (L5792)."""
        axis = self._enabled(first)[0]
        batch: list[tuple[int, ProgramLine]] = []
        number = self.line
        while len(batch) < (1 if self.state is State.ONE_LINE else CONTINUOUS_LINES):
            line = self._program.get(number, NONE)
            if line.pattern not in ("CM", "CA") or line.axes != first.axes:
                break
            batch.append((number, line))
            number += 1
        legs: list[Leg] = []
        here = axis.position + axis.offset
        for _, line in batch:
            value = line.fields[f"ap{axis.index + 1}"]
            target = here + value if line.pattern == "CM" else value
            if abs(target) > MAX_PULSES:
                raise _Stop(State.ERROR)
            legs.append(Leg(target - here, self._speed(axis, line.fields["s"])))
            here = target
        path, passings = continuous(legs)
        epoch, last = self._epoch, batch[-1][1]
        self._trigger.set(None)
        self._outputs.set(first.fields["o"])
        for index, passing in enumerate(passings[:-1]):
            then_ns = at_ns + round(passing * NS_PER_S)
            self._at(then_ns, lambda _, at=index: self._passed(batch[at + 1]))

        def ready(run: Run, ready_ns: int, cause: Cause) -> None:
            if epoch != self._epoch:
                return
            if cause is not Cause.END:
                self._over(State.ERROR)
                return
            self._trigger.fire()
            self._timers.clear()
            self._wait_and_go_on(last, ready_ns, batch[-1][0] + 1)

        self._drive.start([(axis, path)], legs[-1].triple, Kind.MOVE, at_ns, ready)

    def _passed(self, following: tuple[int, ProgramLine]) -> None:
        """A passing point: trigger, then the next line's number and outputs."""
        self._trigger.fire()
        self.line = following[0]
        self._outputs.set(following[1].fields["o"])
