"""One controller of the family, whatever its model: state, time, reset, and the order of actions in an event."""

from orchestrator.clock.base import NS_PER_US
from sim.core.controller import FirmwareTiming
from sim.core.points import PointIsolation
from sim.yaskawa.base import fixed
from sim.yaskawa.base.data import VariableStore
from sim.yaskawa.base.formats import NumberFormat, NumberLayout
from sim.yaskawa.base.options import FamilyOptions
from sim.yaskawa.base.timebase import TIME_WRAP, ServoTimebase
from sim.yaskawa.base.world import PhysicalEnvironment
from sim.yaskawa.io.modbus import RemotePoints
from sim.yaskawa.io.network import DeviceNetwork
from sim.yaskawa.io.points import IoPoints
from sim.yaskawa.language.context import Evaluator
from sim.yaskawa.language.designators import AxisDesignators
from sim.yaskawa.machine.events import AutomaticEvents
from sim.yaskawa.machine.interpreter import SharedInterpreter
from sim.yaskawa.machine.memory import BurnedMemory
from sim.yaskawa.machine.model import ControllerModel
from sim.yaskawa.machine.operator_input import OperatorInput
from sim.yaskawa.machine.programs import FirmwareDelay, ProgramThreads
from sim.yaskawa.machine.recorder import DataRecorder
from sim.yaskawa.machine.schedule import EventSchedule
from sim.yaskawa.machine.signals import SignalInputs
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.codes import ABORT_CODE
from sim.yaskawa.motion.control import MotionAlerts, MotionControl
from sim.yaskawa.ports.ports import PortSession, PortSet
from sim.yaskawa.program.program import StoredProgram

_MARKED, _PLAIN = 1, 2


class ControllerCore:
    """Internal state of the controller. Commands act on it; the clock drives it."""

    def __init__(
        self, timebase: ServoTimebase, model: ControllerModel, options: FamilyOptions, timing: FirmwareTiming, seed: int
    ) -> None:
        self.model = model
        self.options = options
        self.timebase = timebase
        self.environment = PhysicalEnvironment(
            inputs=[True] * options.input_count,
            analog=[0.0] * options.analog_count,
            home_edge=dict(options.home_edge),
            index_every=dict(options.index_every),
            travel=dict(options.travel),
            names=dict(options.names),
        )
        self.question_crlf = options.question_crlf
        self.powered = True
        self.letters = model.letters[: options.axis_count]
        self.memory = BurnedMemory(self)
        self.ports = PortSet(self, model.serial_port, model.second_port)
        self.network: DeviceNetwork | None = None
        """Ethernet network that it is connected to, in addition to the hosts that connect to it."""
        remote = RemotePoints(lambda handle: self.ports.outgoing.get(handle), model.handles) if model.handles else None
        self.io = IoPoints(
            self.environment,
            options.output_count,
            PointIsolation(timebase.clock, options.output_on_us * NS_PER_US, options.output_off_us * NS_PER_US),
            remote=remote,
            missing=options.absent_outputs,
        )
        self.motion = self._new_motion()
        self.delay = FirmwareDelay(timing, options.program_ns, seed)
        self.programs = ProgramThreads(self, self.delay)
        self.interpreter = SharedInterpreter(self, self.delay)
        self.events = AutomaticEvents(self)
        self.schedule = EventSchedule(self)
        self.signals = SignalInputs(self)
        self._reset_state()
        self.memory.restore_burned()

    def _new_motion(self) -> MotionControl:
        figures = self.model.figures
        return MotionControl(
            self.timebase,
            self.environment,
            self.letters,
            figures,
            MotionAlerts(lambda: self.events.handle_limit(), lambda: self.events.handle_error()),
        )

    def _reset_state(self) -> None:
        """Reset volatile state, and set parameters to their defaults."""
        self.data = VariableStore(self.model.room)
        self.program = StoredProgram(self.model.room)
        self.recorder = DataRecorder(self)
        self.layout = NumberLayout(sign_column=self.options.sign_column)
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
        self.designators = AxisDesignators()
        self.locked = 0
        self.operator_input = OperatorInput(self)
        self.selected: bool | None = False if self.options.needs_address else None
        """Whether `%A` has selected this controller; None before any selection."""
        self.second_line: tuple[int, int, int, int] = self.options.second_line
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
        sample_now = self.current_sample()
        if self.schedule.is_quiet(sample_now):
            return  # changes after that computation have started from there
        if self.recorder.due <= sample_now:
            self.recorder.record_due(sample_now)
        self.motion.settle_motion(sample_now)
        self.interpreter.resume_waiting(sample_now)

    def run_ready(self) -> None:
        """Run all that is ready, then schedule the next sample with an event."""
        if not self.powered:
            return
        self.interpreter.resume_waiting(self.current_sample())
        self.events.start_due_routines()
        self.interpreter.run_ready()
        self.schedule.schedule_wake()

    def next_event_sample(self) -> float:
        """Return the next sample with an event that no program causes."""
        return min(self.motion.next_event(), self.recorder.due)

    def advance_to_now(self) -> None:
        """Advance to the present before an access from outside."""
        self.schedule.catch_up()
        self.settle_events()

    def wire_clock(self, source: "ControllerCore") -> None:
        """Wire the sample clock of `source`; it counts while `TM` is negative."""
        self.timebase.connect_source(source.timebase, self._clock_changed)

    def _clock_changed(self) -> None:
        self.handle_rescheduling()
        self.settle_events()
        self.run_ready()

    def handle_rescheduling(self) -> None:
        """Handle a change of the sample length: the next sample is due at another instant."""
        self.schedule.forget_wake()
        self.motion.record.resume_samples()

    # Reset and power

    def reset_controller(self) -> None:
        """`RS` and power-up: restore the burned state (L9643)."""
        sample_now = self.current_sample()
        self.motion.freeze_motion(sample_now, ABORT_CODE)
        for axis in self.motion.all_axes():
            self.motion.record.note_end(axis, sample_now)
        kept_motions, physical = (
            self.motion.record.motions,
            {axis.name: axis.physical_at(sample_now) for axis in self.motion.real},
        )
        stalled_names = {axis.name for axis in self.motion.real if axis.stalled}
        self.interpreter.reset_threads()
        self.handle_rescheduling()
        self.timebase.reset_samples()
        self.motion = self._new_motion()
        self.motion.record.motions = kept_motions
        for axis in self.motion.real:
            axis.physical_zero = -physical[axis.name]
            axis.stalled = axis.name in stalled_names
        self._reset_state()
        self.memory.restore_burned()

    def master_reset(self, port: PortSession) -> None:
        """Ctrl-R ctrl-S: factory state, burned values erased (L9663)."""
        self.memory.erase_burned()
        self.reset_controller()
        port.queue.clear()
        port.emit_text(":")

    def set_power(self, *, on: bool) -> None:
        """Switch the power. Off: everything stops dead and connections drop. On: power-up."""
        if on == self.powered:
            return
        if not on:
            self.advance_to_now()
            self.ports.drop_all()
            self.motion.freeze_motion(self.current_sample(), ABORT_CODE)
            for axis in self.motion.all_axes():
                self.motion.record.note_end(axis, self.current_sample())
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
        moved_axes = [axis for axis in self.motion.real if axis.is_moving]
        self.motion.freeze_motion(at, code)
        for axis in self.motion.real:
            if axis.registers["OE"]:
                self.motion.switch_motor_off(axis, at)
        if self.motion.contouring.running is not None:
            self.motion.contouring.leave_contour(at, code)
        for axis in moved_axes:
            axis.stop_code = code
        if halt:
            self.programs.halt_all()

    # Names and replies

    def find_axis(self, name: str) -> ServoAxis:
        """Return the axis of a designator; 4 when there is none."""
        return self.motion.find_axis(self.designators.resolve_name(name))

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

    def compile_operand(self, text: str) -> Evaluator:
        """Return the function that reads `_XX…`; 58 when there is no such operand."""
        return self.model.compile_operand(text)
