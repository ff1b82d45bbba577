"""One controller of the family, whatever its model: state, time, reset, and the order of what happens in an event."""

import random
from math import inf

from orchestrator.clock.base import Clock, Timer
from sim.core.controller import Timing
from sim.core.oscillator import Oscillator
from sim.yaskawa.base import fixed
from sim.yaskawa.base.data import Data
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.formats import Format, Layout
from sim.yaskawa.base.model import Model
from sim.yaskawa.base.options import Options
from sim.yaskawa.base.timebase import NEVER_NS, TIME_WRAP, Timebase
from sim.yaskawa.base.world import World
from sim.yaskawa.events import Events
from sim.yaskawa.io import Points
from sim.yaskawa.language.expressions import compile_expression
from sim.yaskawa.memory import Memory
from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.motion.control import ABORT_CODE, ABORT_INPUT_CODE, SELECTIVE_CODE, MotionControl
from sim.yaskawa.ports.modbus import RemotePoints
from sim.yaskawa.ports.network import Network
from sim.yaskawa.ports.ports import Port, Ports
from sim.yaskawa.program.entry import OperatorEntry
from sim.yaskawa.program.interpreter import LEEWAY_NS, Interpreter
from sim.yaskawa.program.program import Program
from sim.yaskawa.recorder import Recorder

_LATCHES = {**{number: number - 1 for number in range(1, 5)}, **{number: number - 5 for number in range(9, 13)}}
"""For each input that latches a position: the number of the axis (SMC-2000: L7105)."""
_AXIS_NUMBERS = {0: "X", 1: "Y", 2: "Z", 3: "W", 8: "S", 9: "T", 10: "N"}
_MARKED, _PLAIN = 1, 2


class Machine:
    """Everything inside the box. Commands act on it; it drives itself by the clock."""

    def __init__(
        self, clock: Clock, model: Model, options: Options, oscillator: Oscillator, timing: Timing, seed: int
    ) -> None:
        self.model = model
        self.options = options
        self.timing = timing
        self.timebase = Timebase(clock, oscillator)
        self.world = World(
            inputs=[True] * options.inputs,
            analog=[0.0] * options.analog,
            home_edge=dict(options.home_edge),
            index_every=dict(options.index_every),
            travel=dict(options.travel),
        )
        self.question_crlf = options.question_crlf
        self.powered = True
        self._random = random.Random(seed)
        self.letters = model.letters[: options.axis_count]
        self.memory = Memory(self)
        self.ports = Ports(self)
        self.network: Network | None = None
        """What Ethernet joins it to, beside the hosts that connect to it."""
        remote = RemotePoints(lambda handle: self.ports.outgoing.get(handle), model.handles) if model.handles else None
        self.io = Points(self.world, options.outputs, remote=remote, missing=options.absent_outputs)
        self.motion = self._new_motion()
        self.interpreter = Interpreter(self, self._delay_ns)
        self.events = Events(self)
        self._wake_sample: float = -inf
        """The next sample where something happens by itself, as far as it is known."""
        self._wake_ns = NEVER_NS
        self._wake_leeway_ns = 0
        self._alarm: Timer | None = None
        self._alarm_ns = (NEVER_NS, 0)
        """When it is due, and how late it may be."""
        self._catching_up = False
        self._clear()
        self.memory.restore()

    def _new_motion(self) -> MotionControl:
        figures = self.model.figures
        return MotionControl(
            self.timebase,
            self.world,
            self.letters,
            figures,
            on_limit=lambda: self.events.met_limit(),
            on_error=lambda: self.events.met_error(),
        )

    def _delay_ns(self, program: bool) -> int:
        spread_ns = self.timing.spread_ns
        spent_ns = self.timing.decode_ns + (self._random.randrange(spread_ns + 1) if spread_ns else 0)
        return spent_ns + self.options.program_ns if program else spent_ns

    @property
    def instant_programs(self) -> bool:
        """Whether a program's command takes no time."""
        return not (self.timing.decode_ns or self.options.program_ns)

    def _clear(self) -> None:
        """Volatile state, and parameters at their defaults."""
        self.data = Data(self.model.room)
        self.program = Program(self.model.room)
        self.recorder = Recorder(self)
        self.layout = Layout(False, self.options.sign_column)
        self.position_format = Format(10, 0)
        self.variable_format = Format(10, 4)
        self.error_code = 0
        self.echo = self.options.echo or (self.model.factory_echo and self.memory.factory)
        self.unsolicited_port = "S"
        self.unsolicited_mode = _PLAIN
        self.polarity = [-1, -1, -1, 0]
        self.modbus_wait = True
        self.address = self.options.address
        self.retry_time = 250
        self.system_letter = "S"
        self.designators: dict[str, str] = {}
        self.locked = 0
        self.entries = {name: OperatorEntry() for name in ("S", "2")}
        self.selected: bool | None = False if self.options.unaddressed else None
        """Whether `%A` has selected this unit; None while no unit has been."""
        self.second_line = self.options.second_line
        """`CC`: baud rate of port 2, handshake, daisy chain, echo; baud 0 before it is given."""
        self.interrupting: dict[str, int] = {"S": 0, "2": 0}
        """`CI`: what on each serial port calls #COMINT: 0 nothing, 1 carriage return, 2 any character."""
        self.interrupting_on = False
        if self.model.figures.default_plane and len(self.letters) > 1:
            for system in self.motion.systems.values():
                system.select(("X", "Y"), linear=False)
        self.gear_master = ""
        """The one master of all axes (SMC-2000: L9015)."""
        self.motion.cam.master_cycle = 0 if self.options.own_modulus else None
        self.last_encoder = 0
        """Number of the axis whose absolute encoder was read last."""
        for axis in self.motion.axes.values():
            axis.registers = {name: parameter.default for name, parameter in self.model.parameters.items()}

    # Time

    def now(self) -> int:
        """The sample that runs."""
        return self.timebase.sample()

    def time_counter(self) -> int:
        """`TIME` (D21: wraps to 0)."""
        return self.timebase.sample() % TIME_WRAP

    def settle(self) -> None:
        """Bring motion, recording and trippoints up to the present sample."""
        if not self.powered:
            return
        now = self.now()
        if now < self._wake_sample:
            return  # whatever has changed since that was worked out has gone on from there
        if self.recorder.due <= now:
            self.recorder.run(now)
        self.motion.settle(now)
        self.interpreter.release(now)

    def go_on(self) -> None:
        """Run what is ready, then arrange to be called at the next sample where something happens."""
        if not self.powered:
            return
        self.interpreter.release(self.now())
        self.events.poll()
        self.interpreter.pump()
        self.arrange()

    def arrange(self) -> None:
        """Be called at the next sample where something happens."""
        now = self.now()
        soon = self.soon()
        due = min(soon, self.interpreter.due(now))
        if due != self._wake_sample:
            self._wake_sample, self._wake_ns, self._wake_leeway_ns = due, NEVER_NS, 0
            if due != inf:
                self._wake_ns = self.timebase.true_ns(int(max(due, now)))
                # Of what is due first only a program that waits may be seen to later.
                if due < soon and self.interpreter.unseen_at(due, now):
                    self._wake_leeway_ns = LEEWAY_NS
        self.set_alarm()

    def moved_on(self) -> None:
        """Somebody has had happen what was to come first."""
        self._wake_sample, self._wake_ns = -inf, NEVER_NS
        self.arrange()

    def soon(self) -> float:
        """The next sample at which something happens that no program does."""
        return min(self.motion.due(), self.recorder.due)

    def set_alarm(self) -> None:
        """Be called for whatever comes first: a sample, or a command that has been decoded."""
        if self._catching_up:
            return  # once for all of it
        interpreter = self.interpreter
        due_ns = min(self._wake_ns, interpreter.decoded_ns)
        last_ns = min(self._wake_ns + self._wake_leeway_ns, interpreter.decoded_ns + interpreter.leeway_ns)
        if self._alarm is not None:
            if self._alarm_ns == (due_ns, last_ns):
                return
            self._alarm.cancel()
            self._alarm = None
        if due_ns != NEVER_NS:
            self._alarm_ns = (due_ns, last_ns)
            self._alarm = self.timebase.clock.call_at_ns(due_ns, self._ring, last_ns - due_ns)

    def look(self) -> None:
        """Somebody looks, or does something, from outside."""
        self.catch_up()
        self.settle()

    def catch_up(self) -> None:
        """Live, timers are late: what was due before something comes from outside has happened before it."""
        now_ns = self.timebase.clock.now_ns()
        if min(self._wake_ns, self.interpreter.decoded_ns) >= now_ns:
            return
        outer, self._catching_up = self._catching_up, True
        try:
            while self.powered and min(self._wake_ns, self.interpreter.decoded_ns) < now_ns:
                if not self.interpreter.poll_alone(self._wake_ns, now_ns):
                    self._next()
        finally:
            self._catching_up = outer
        self.set_alarm()

    def _next(self) -> None:
        """Have happen what comes first."""
        if self._wake_ns <= self.interpreter.decoded_ns:
            self._wake()
        else:
            self.interpreter.decoded()

    def _ring(self) -> None:
        self._alarm = None
        # What was due before, and could be late, has happened before.
        self.catch_up()
        if self.powered and min(self._wake_ns, self.interpreter.decoded_ns) <= self.timebase.clock.now_ns():
            self._next()
        self.catch_up()
        self.set_alarm()

    def _wake(self) -> None:
        timebase = self.timebase
        timebase.begin(self._wake_ns)
        self._wake_ns, self._wake_sample = NEVER_NS, -inf
        try:
            self.settle()
            self.go_on()
        finally:
            timebase.end()

    def wire_clock(self, source: "Machine") -> None:
        """A wire brings the sample clock of `source`; it counts while `TM` is negative."""
        self.timebase.wire(source.timebase, self._clock_changed)

    def _clock_changed(self) -> None:
        self.rescheduled()
        self.settle()
        self.go_on()

    def rescheduled(self) -> None:
        """The samples have changed their length: the next one is due at another instant."""
        self._wake_ns, self._wake_sample = NEVER_NS, -inf
        self.motion.samples_again()

    # Reset and power

    def reset(self) -> None:
        """`RS` and power-up: the burned state (L9643)."""
        now = self.now()
        self.motion.freeze(now, ABORT_CODE)
        for axis in self.motion.all_axes():
            self.motion.note_end(axis, now)
        kept, physical = self.motion.motions, {axis.name: axis.physical(now) for axis in self.motion.real}
        stalled = {axis.name for axis in self.motion.real if axis.stalled}
        self.interpreter.reset()
        self.rescheduled()
        self.timebase.reset()
        self.motion = self._new_motion()
        self.motion.motions = kept
        for axis in self.motion.real:
            axis.physical_zero = -physical[axis.name]
            axis.stalled = axis.name in stalled
        self._clear()
        self.memory.restore()

    def master_reset(self, port: Port) -> None:
        """Ctrl-R ctrl-S: factory state, nothing burned (L9663)."""
        self.memory.erase()
        self.reset()
        port.queue.clear()
        port.emit(":")

    def set_power(self, on: bool) -> None:
        """Off: everything stops dead and connections drop. On: power-up."""
        if on == self.powered:
            return
        if not on:
            self.look()
            self.ports.drop_all()
            self.motion.freeze(self.now(), ABORT_CODE)
            for axis in self.motion.all_axes():
                self.motion.note_end(axis, self.now())
            self.interpreter.reset()
            self.rescheduled()
            self.io.set_all(0)
            self.timebase.halt()
            self.powered = False
        else:
            self.powered = True
            self.reset()
            self.go_on()

    # The world

    def abort(self, code: int, *, halt: bool) -> None:
        """`AB` and the abort input: everything freezes, amplifiers with OE go off (L2191)."""
        at = self.timebase.next_sample()
        moved = [axis for axis in self.motion.real if axis.moving]
        self.motion.freeze(at, code)
        for axis in self.motion.real:
            if axis.registers["OE"]:
                self.motion.motor_off(axis, at)
        if self.motion.contour is not None:
            self.motion.leave_contour(at, code)
        for axis in moved:
            axis.stop_code = code
        if halt:
            self.interpreter.halt_all()

    def set_abort_input(self, active: bool) -> None:
        """The abort input: as `AB`, and nothing begins while it is active (D36)."""
        self.look()
        self.motion.abort_input = active
        if active:
            self.abort(ABORT_INPUT_CODE, halt=True)
        self.go_on()

    def set_input(self, number: int, level: bool) -> None:
        """A local input changes: latches, interrupts, selective abort."""
        if not 1 <= number <= len(self.world.inputs):
            raise ValueError(f"input {number}: this controller has inputs 1 to {len(self.world.inputs)}")
        self.look()
        if self.world.inputs[number - 1] != level:
            self.world.inputs[number - 1] = level
            if self.powered:
                self._input_changed(number, level)
        self.go_on()

    def _input_changed(self, number: int, level: bool) -> None:
        now = self.now()
        latch = _LATCHES.get(number, len(self.letters))
        if latch < len(self.letters) and level == (self.polarity[2] > 0):
            axis = self.motion.real[latch]
            if axis.latch_armed:
                self.motion.latch(axis, now)
        if number > 4 and self.polarity[3] and not level and number - 5 < len(self.letters):
            self.motion.freeze(now, SELECTIVE_CODE, (self.motion.real[number - 5],))
        self.events.inputs_changed(number, level)

    def limits_changed(self) -> None:
        """Limit switches have been pressed or let go: what moves into one stops."""
        if self.powered:
            self.motion.look_at_limits(self.timebase.next_sample())

    # Names and replies

    def axis(self, name: str) -> Axis:
        """The axis that a designator stands for; 4 when there is none."""
        if name.startswith("~"):
            name = self.designators.get(name, "")
        axis = self.motion.axes.get(name)
        if axis is None:
            raise CommandError(28 if name in ("S", "T") else 4)
        return axis

    def name_axis(self, designator: str, letter: str) -> None:
        """`~a="X"`."""
        if letter not in _AXIS_NUMBERS.values():
            raise CommandError(4)
        self.designators[designator] = letter

    def designated(self, designator: str) -> int:
        """What `~a` is as a number (L7811); 4 before it is given."""
        letter = self.designators.get(designator)
        if letter is None:
            raise CommandError(4)
        return next(number for number, name in _AXIS_NUMBERS.items() if name == letter)

    def number_axis(self, designator: str, number: int) -> None:
        """`~a=2`."""
        if number not in _AXIS_NUMBERS:
            raise CommandError(6)
        self.designators[designator] = _AXIS_NUMBERS[number]

    def show_value(self, raw: int) -> str:
        """A number in the variable format."""
        return self.variable_format.write(raw, self.layout)

    def show_counts(self, counts: int) -> str:
        """A position in the position format."""
        return self.position_format.write(counts * fixed.ONE, self.layout)

    def show_whole(self, number: int, digits: int) -> str:
        """An integer in a format of its own, e.g. `TI` in 3.0."""
        return Format(digits, 0).write(number * fixed.ONE, self.layout)

    def show(self, op: str, raw: int) -> str:
        """The answer to `op?` of a command that is no parameter of axes."""
        form = self.model.formats.get(op, self.variable_format)
        return (form or self.position_format).write(raw, self.layout)

    def fail(self, code: int) -> None:
        """A command is refused: what `TC` will tell."""
        self.error_code = self.model.codes.get(code, code)

    @property
    def revision(self) -> str:
        """What ctrl-R ctrl-V tells."""
        return self.model.revision.format(options=self.options)

    @property
    def mark_unsolicited(self) -> bool:
        return self.unsolicited_mode == _MARKED

    def locks(self, op: str, lock: str, text: str) -> bool:
        """Whether `LC` forbids a command from a port (SMC-4000: L6735, SMC-2000: L9876)."""
        return bool(self.locked) and self.model.locks(self.locked, op, lock, text)

    # Serial input of programs

    def serial_arrived(self, text: str) -> None:
        """Remember the last character for `P1CH` (SMC-4000: L12105)."""
        self.entries["S"].notice(text)

    def keyword(self, name: str) -> int:
        """`P1CH`, `P2NM`, …: what came in on a serial port."""
        return self.entries["S" if name[1] == "1" else "2"].read(name[2:])

    def take_input(self, port: Port, line: str) -> bool:
        """Whether `line` answers an IN (SMC-4000: L6101, SMC-2000: L9352)."""
        main = self.interpreter.threads[0]
        if port.kind != "serial" or not main.input_for or main.input_port != port.name:
            return False
        name, main.input_for = main.input_for, ""
        text = line.split(";")[0]
        if text:
            try:
                self._assign_input(name, self._input_value(text, main.input_length))
            except (ValueError, CommandError):
                self.fail(83)
        return True

    def _assign_input(self, name: str, raw: int) -> None:
        array, bracket, index = name.partition("[")
        if bracket:
            place = compile_expression(index.removesuffix("]"))(self.interpreter.contexts[0])
            self.data.store(array, fixed.truncated(place), raw)
        else:
            self.data.assign(name, raw)

    def _input_value(self, text: str, length: int) -> int:
        """A number, or with `length` (of `{Sn}`), or when it is none, a string."""
        try:
            if not length:
                return fixed.literal(text.removeprefix("-")) * (-1 if text.startswith("-") else 1)
        except ValueError:
            pass
        return fixed.of_string(text[: length or fixed.STRING_LENGTH])
