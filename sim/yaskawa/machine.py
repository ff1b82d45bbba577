"""One controller of the family, whatever its model: state, time, reset, and the order of actions in an event."""

import random
from math import inf

from orchestrator.clock.base import Clock, Timer
from sim.core.controller import FirmwareTiming
from sim.core.oscillator import Oscillator
from sim.yaskawa.base import fixed
from sim.yaskawa.base.data import VariableStore
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.formats import NumberFormat, NumberLayout
from sim.yaskawa.base.model import ControllerModel
from sim.yaskawa.base.options import FamilyOptions
from sim.yaskawa.base.timebase import NEVER_NS, TIME_WRAP, ServoTimebase
from sim.yaskawa.base.world import PhysicalEnvironment
from sim.yaskawa.events import AutomaticEvents
from sim.yaskawa.io import IoPoints
from sim.yaskawa.language.expressions import compile_expression
from sim.yaskawa.memory import BurnedMemory
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.control import ABORT_CODE, ABORT_INPUT_CODE, SELECTIVE_CODE, MotionControl
from sim.yaskawa.ports.modbus import RemotePoints
from sim.yaskawa.ports.network import DeviceNetwork
from sim.yaskawa.ports.ports import PortSession, PortSet
from sim.yaskawa.program.entry import OperatorEntry
from sim.yaskawa.program.interpreter import LEEWAY_NS, SharedInterpreter
from sim.yaskawa.program.program import StoredProgram
from sim.yaskawa.recorder import DataRecorder

_LATCHES = {**{number: number - 1 for number in range(1, 5)}, **{number: number - 5 for number in range(9, 13)}}
"""For each input that latches a position: the number of the axis (SMC-2000: L7105)."""
_AXIS_NUMBERS = {0: "X", 1: "Y", 2: "Z", 3: "W", 8: "S", 9: "T", 10: "N"}
_MARKED, _PLAIN = 1, 2


class ControllerCore:
    """Internal state of the controller. Commands act on it; the clock drives it."""

    def __init__(
        self,
        clock: Clock,
        model: ControllerModel,
        options: FamilyOptions,
        oscillator: Oscillator,
        timing: FirmwareTiming,
        seed: int,
    ) -> None:
        self.model = model
        self.options = options
        self.timing = timing
        self.timebase = ServoTimebase(clock, oscillator)
        self.environment = PhysicalEnvironment(
            inputs=[True] * options.input_count,
            analog=[0.0] * options.analog_count,
            home_edge=dict(options.home_edge),
            index_every=dict(options.index_every),
            travel=dict(options.travel),
        )
        self.question_crlf = options.question_crlf
        self.powered = True
        self._random = random.Random(seed)
        self.letters = model.letters[: options.axis_count]
        self.memory = BurnedMemory(self)
        self.ports = PortSet(self)
        self.network: DeviceNetwork | None = None
        """Ethernet network that it is connected to, in addition to the hosts that connect to it."""
        remote = RemotePoints(lambda handle: self.ports.outgoing.get(handle), model.handles) if model.handles else None
        self.io = IoPoints(self.environment, options.output_count, remote=remote, missing=options.absent_outputs)
        self.motion = self._new_motion()
        self.interpreter = SharedInterpreter(self, self._delay_ns)
        self.events = AutomaticEvents(self)
        self._wake_sample: float = -inf
        """The next sample with an event, as far as it is known."""
        self._wake_ns = NEVER_NS
        self._wake_leeway_ns = 0
        self._alarm: Timer | None = None
        self._alarm_ns = (NEVER_NS, 0)
        """Its due time, and the leeway."""
        self._catching_up = False
        self._reset_state()
        self.memory.restore_burned()

    def _new_motion(self) -> MotionControl:
        figures = self.model.figures
        return MotionControl(
            self.timebase,
            self.environment,
            self.letters,
            figures,
            on_limit=lambda: self.events.handle_limit(),
            on_error=lambda: self.events.handle_error(),
        )

    def _delay_ns(self, program: bool) -> int:
        spread_ns = self.timing.spread_ns
        spent_ns = self.timing.decode_ns + (self._random.randrange(spread_ns + 1) if spread_ns else 0)
        return spent_ns + self.options.program_ns if program else spent_ns

    @property
    def instant_programs(self) -> bool:
        """Return whether a program's command takes no time."""
        return not (self.timing.decode_ns or self.options.program_ns)

    def _reset_state(self) -> None:
        """Reset volatile state, and set parameters to their defaults."""
        self.data = VariableStore(self.model.room)
        self.program = StoredProgram(self.model.room)
        self.recorder = DataRecorder(self)
        self.layout = NumberLayout(False, self.options.sign_column)
        self.position_format = NumberFormat(10, 0)
        self.variable_format = NumberFormat(10, 4)
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
        self.selected: bool | None = False if self.options.needs_address else None
        """Whether `%A` has selected this controller; None before any selection."""
        self.second_line = self.options.second_line
        """`CC`: baud rate of port 2, handshake, daisy chain, echo; baud 0 before it is given."""
        self.interrupting: dict[str, int] = {"S": 0, "2": 0}
        """`CI`: the event on each serial port that calls #COMINT: 0 none, 1 carriage return, 2 any character."""
        self.interrupting_on = False
        if self.model.figures.default_plane and len(self.letters) > 1:
            for system in self.motion.systems.values():
                system.select_axes(("X", "Y"), linear=False)
        self.gear_master = ""
        """The one master of all axes (SMC-2000: L9015)."""
        self.motion.cam.master_cycle = 0 if self.options.own_modulus else None
        self.last_encoder = 0
        """Number of the axis whose absolute encoder was read last."""
        for axis in self.motion.axes.values():
            axis.registers = {name: parameter.default for name, parameter in self.model.parameters.items()}

    # Time

    def current_sample(self) -> int:
        """Present sample."""
        return self.timebase.current_sample()

    def time_counter(self) -> int:
        """`TIME` (D21: wraps to 0)."""
        return self.timebase.current_sample() % TIME_WRAP

    def settle_events(self) -> None:
        """Advance motion, recording and trippoints to the present sample."""
        if not self.powered:
            return
        now = self.current_sample()
        if now < self._wake_sample:
            return  # changes after that computation have started from there
        if self.recorder.due <= now:
            self.recorder.record_due(now)
        self.motion.settle_motion(now)
        self.interpreter.resume_waiting(now)

    def run_ready(self) -> None:
        """Run all that is ready, then schedule the next sample with an event."""
        if not self.powered:
            return
        self.interpreter.resume_waiting(self.current_sample())
        self.events.start_due_routines()
        self.interpreter.run_ready()
        self.schedule_wake()

    def schedule_wake(self) -> None:
        """Schedule a call at the next sample with an event."""
        now = self.current_sample()
        soon = self.next_event_sample()
        due = min(soon, self.interpreter.next_check(now))
        if due != self._wake_sample:
            self._wake_sample, self._wake_ns, self._wake_leeway_ns = due, NEVER_NS, 0
            if due != inf:
                self._wake_ns = self.timebase.true_ns(int(max(due, now)))
                # Of the due events only a waiting program may be processed later.
                if due < soon and self.interpreter.only_waits_at(due, now):
                    self._wake_leeway_ns = LEEWAY_NS
        self.set_alarm()

    def discard_schedule(self) -> None:
        """Discard the schedule after the next event was processed elsewhere."""
        self._wake_sample, self._wake_ns = -inf, NEVER_NS
        self.schedule_wake()

    def next_event_sample(self) -> float:
        """Return the next sample with an event that no program causes."""
        return min(self.motion.next_event(), self.recorder.due)

    def set_alarm(self) -> None:
        """Set the alarm for the earliest event: a sample, or a decoded command."""
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
            self._alarm = self.timebase.clock.call_at_ns(due_ns, self._handle_alarm, last_ns - due_ns)

    def advance_to_now(self) -> None:
        """Advance to the present before an access from outside."""
        self.catch_up()
        self.settle_events()

    def catch_up(self) -> None:
        """Process the events due before an input from outside: live, timers are late."""
        now_ns = self.timebase.clock.now_ns()
        if min(self._wake_ns, self.interpreter.decoded_ns) >= now_ns:
            return
        outer, self._catching_up = self._catching_up, True
        try:
            while self.powered and min(self._wake_ns, self.interpreter.decoded_ns) < now_ns:
                if not self.interpreter.poll_alone(self._wake_ns, now_ns):
                    self._process_next()
        finally:
            self._catching_up = outer
        self.set_alarm()

    def _process_next(self) -> None:
        """Process the earliest event."""
        if self._wake_ns <= self.interpreter.decoded_ns:
            self._handle_wake()
        else:
            self.interpreter.run_decoded()

    def _handle_alarm(self) -> None:
        self._alarm = None
        # Earlier events that were allowed to be late have been processed before.
        self.catch_up()
        if self.powered and min(self._wake_ns, self.interpreter.decoded_ns) <= self.timebase.clock.now_ns():
            self._process_next()
        self.catch_up()
        self.set_alarm()

    def _handle_wake(self) -> None:
        timebase = self.timebase
        timebase.begin_event(self._wake_ns)
        self._wake_ns, self._wake_sample = NEVER_NS, -inf
        try:
            self.settle_events()
            self.run_ready()
        finally:
            timebase.end_event()

    def wire_clock(self, source: "ControllerCore") -> None:
        """Wire the sample clock of `source`; it counts while `TM` is negative."""
        self.timebase.connect_source(source.timebase, self._clock_changed)

    def _clock_changed(self) -> None:
        self.handle_rescheduling()
        self.settle_events()
        self.run_ready()

    def handle_rescheduling(self) -> None:
        """Handle a change of the sample length: the next sample is due at another instant."""
        self._wake_ns, self._wake_sample = NEVER_NS, -inf
        self.motion.resume_samples()

    # Reset and power

    def reset_controller(self) -> None:
        """`RS` and power-up: restore the burned state (L9643)."""
        now = self.current_sample()
        self.motion.freeze_motion(now, ABORT_CODE)
        for axis in self.motion.all_axes():
            self.motion.note_end(axis, now)
        kept, physical = self.motion.motions, {axis.name: axis.physical_at(now) for axis in self.motion.real}
        stalled = {axis.name for axis in self.motion.real if axis.stalled}
        self.interpreter.reset_threads()
        self.handle_rescheduling()
        self.timebase.reset_samples()
        self.motion = self._new_motion()
        self.motion.motions = kept
        for axis in self.motion.real:
            axis.physical_zero = -physical[axis.name]
            axis.stalled = axis.name in stalled
        self._reset_state()
        self.memory.restore_burned()

    def master_reset(self, port: PortSession) -> None:
        """Ctrl-R ctrl-S: factory state, burned values erased (L9663)."""
        self.memory.erase_burned()
        self.reset_controller()
        port.queue.clear()
        port.emit_text(":")

    def set_power(self, on: bool) -> None:
        """Switch the power. Off: everything stops dead and connections drop. On: power-up."""
        if on == self.powered:
            return
        if not on:
            self.advance_to_now()
            self.ports.drop_all()
            self.motion.freeze_motion(self.current_sample(), ABORT_CODE)
            for axis in self.motion.all_axes():
                self.motion.note_end(axis, self.current_sample())
            self.interpreter.reset_threads()
            self.handle_rescheduling()
            self.io.set_all(0)
            self.timebase.halt_samples()
            self.powered = False
        else:
            self.powered = True
            self.reset_controller()
            self.run_ready()

    # Environment

    def abort_motion(self, code: int, *, halt: bool) -> None:
        """`AB` and the abort input: everything freezes, amplifiers with OE switch off (L2191)."""
        at = self.timebase.next_sample()
        moved = [axis for axis in self.motion.real if axis.is_moving]
        self.motion.freeze_motion(at, code)
        for axis in self.motion.real:
            if axis.registers["OE"]:
                self.motion.switch_motor_off(axis, at)
        if self.motion.contour is not None:
            self.motion.leave_contour(at, code)
        for axis in moved:
            axis.stop_code = code
        if halt:
            self.interpreter.halt_all()

    def set_abort_input(self, active: bool) -> None:
        """Set the abort input: as `AB`, and no motion begins while it is active (D36)."""
        self.advance_to_now()
        self.motion.abort_input = active
        if active:
            self.abort_motion(ABORT_INPUT_CODE, halt=True)
        self.run_ready()

    def set_input(self, number: int, level: bool) -> None:
        """Change a local input: latches, interrupts, selective abort."""
        if not 1 <= number <= len(self.environment.inputs):
            raise ValueError(f"input {number}: this controller has inputs 1 to {len(self.environment.inputs)}")
        self.advance_to_now()
        if self.environment.inputs[number - 1] != level:
            self.environment.inputs[number - 1] = level
            if self.powered:
                self._input_changed(number, level)
        self.run_ready()

    def _input_changed(self, number: int, level: bool) -> None:
        now = self.current_sample()
        latch = _LATCHES.get(number, len(self.letters))
        if latch < len(self.letters) and level == (self.polarity[2] > 0):
            axis = self.motion.real[latch]
            if axis.latch_armed:
                self.motion.capture_latch(axis, now)
        if number > 4 and self.polarity[3] and not level and number - 5 < len(self.letters):
            self.motion.freeze_motion(now, SELECTIVE_CODE, (self.motion.real[number - 5],))
        self.events.inputs_changed(number, level)

    def limits_changed(self) -> None:
        """Handle a change of limit switches: an axis that moves into one stops."""
        if self.powered:
            self.motion.check_limits(self.timebase.next_sample())

    # Names and replies

    def find_axis(self, name: str) -> ServoAxis:
        """Return the axis of a designator; 4 when there is none."""
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

    def designator_number(self, designator: str) -> int:
        """Return the value of `~a` as a number (L7811); 4 before it is given."""
        letter = self.designators.get(designator)
        if letter is None:
            raise CommandError(4)
        return next(number for number, name in _AXIS_NUMBERS.items() if name == letter)

    def number_axis(self, designator: str, number: int) -> None:
        """`~a=2`."""
        if number not in _AXIS_NUMBERS:
            raise CommandError(6)
        self.designators[designator] = _AXIS_NUMBERS[number]

    def format_variable(self, raw: int) -> str:
        """Format a number in the variable format."""
        return self.variable_format.format_value(raw, self.layout)

    def format_counts(self, counts: int) -> str:
        """Format a position in the position format."""
        return self.position_format.format_value(counts * fixed.ONE, self.layout)

    def format_integer(self, number: int, digits: int) -> str:
        """Format an integer in a format of its own, e.g. `TI` in 3.0."""
        return NumberFormat(digits, 0).format_value(number * fixed.ONE, self.layout)

    def format_answer(self, op: str, raw: int) -> str:
        """Format the answer to `op?` of a command that is not a parameter of axes."""
        form = self.model.formats.get(op, self.variable_format)
        return (form or self.position_format).format_value(raw, self.layout)

    def refuse_command(self, code: int) -> None:
        """Refuse a command: store the code that `TC` reports."""
        self.error_code = self.model.codes.get(code, code)

    @property
    def revision_text(self) -> str:
        """The text that ctrl-R ctrl-V reports."""
        return self.model.revision.format(options=self.options)

    @property
    def mark_unsolicited(self) -> bool:
        return self.unsolicited_mode == _MARKED

    def is_locked_command(self, op: str, lock: str, text: str) -> bool:
        """Return whether `LC` forbids a command from a port (SMC-4000: L6735, SMC-2000: L9876)."""
        return bool(self.locked) and self.model.locks(self.locked, op, lock, text)

    # Serial input of programs

    def store_serial_input(self, text: str) -> None:
        """Store the last character for `P1CH` (SMC-4000: L12105)."""
        self.entries["S"].note_characters(text)

    def read_keyword(self, name: str) -> int:
        """`P1CH`, `P2NM`, …: return the value received on a serial port."""
        return self.entries["S" if name[1] == "1" else "2"].read_item(name[2:])

    def accept_input(self, port: PortSession, line: str) -> bool:
        """Return whether `line` answers an IN (SMC-4000: L6101, SMC-2000: L9352)."""
        main = self.interpreter.threads[0]
        if port.kind != "serial" or not main.input_for or main.input_port != port.name:
            return False
        name, main.input_for = main.input_for, ""
        text = line.split(";")[0]
        if text:
            try:
                self._assign_input(name, self._input_value(text, main.input_length))
            except (ValueError, CommandError):
                self.refuse_command(83)
        return True

    def _assign_input(self, name: str, raw: int) -> None:
        array, bracket, index = name.partition("[")
        if bracket:
            place = compile_expression(index.removesuffix("]"))(self.interpreter.contexts[0])
            self.data.store_element(array, fixed.to_integer(place), raw)
        else:
            self.data.assign_variable(name, raw)

    def _input_value(self, text: str, length: int) -> int:
        """Parse a number, or with `length` (of `{Sn}`), or when it is not a number, a string."""
        try:
            if not length:
                return fixed.parse_literal(text.removeprefix("-")) * (-1 if text.startswith("-") else 1)
        except ValueError:
            pass
        return fixed.from_string(text[: length or fixed.STRING_LENGTH])
