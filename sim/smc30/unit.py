"""One SMC30: its modes and its replies (L1369-L1573)."""

import re
from collections.abc import Callable
from enum import Enum, auto
from functools import partial

from sim.core.devicetime import DeviceTime
from sim.smc30.actions import StatementExecutor, StatementTargets
from sim.smc30.drive import StepGenerator
from sim.smc30.expressions import OperandValues
from sim.smc30.framing import ReceivedString
from sim.smc30.inputs import InputLevels
from sim.smc30.memory import PermanentMemory, WorkingMemory
from sim.smc30.modules import ExternalModules
from sim.smc30.motor import Activity, MotorCommands
from sim.smc30.operands import PredefinedRegister
from sim.smc30.options import IndexerOptions
from sim.smc30.outputs import UserOutputs
from sim.smc30.parameters import MotorParameters
from sim.smc30.parser import read_statement, strip_blanks
from sim.smc30.program import ProgramInterpreter
from sim.smc30.queries import QueryAnswers
from sim.smc30.refusal import Code, StatementRefused
from sim.smc30.statements import (
    AssignRegister,
    Flow,
    InitializeState,
    MoveAnalogue,
    MoveSteps,
    RunOn,
    SearchHome,
    SetCurrent,
    Statement,
    StoredLine,
)
from sim.smc30.tempo import PausableTimer

_NS_PER_MS = 1_000_000
_SYSTEM = re.compile(r"(PE|PO|PX|TP|V1|V2|VS|VT|VR|VA|[EFKMQXZ])([+-]?\d*)")
_MOST_MILLIAMPS = {"SMC30B": 6000, "SMC30C": 12_000}
"""Highest current of CS, CR and CT (L2008)."""
_NOT_IN_PROGRAMMING = frozenset(("M", "X", "V1", "V2"))
"""Not accepted in Programming Mode: neither storable nor documented there (L2459)."""


class IndexerMode(Enum):
    """Standby and Programming; Execute is the state in which the program runs."""

    STANDBY = auto()
    PROGRAMMING = auto()


class StepIndexer:
    """A device and its peripherals. `emit` receives a reply without checksum and CR.

    poll_phase: phase of the firmware's polling of the user inputs, 0 to 1 of its period.
    """

    def __init__(
        self,
        time: DeviceTime,
        options: IndexerOptions,
        drive: StepGenerator,
        emit: Callable[[str], None],
        poll_phase: float = 0.0,
    ) -> None:
        self.axis = drive.axis
        self.time = time
        self.options = options
        self._emit = emit
        self._tempo = PausableTimer(time)
        self._store_tempo = PausableTimer(time)
        """Timer of the permanent memory, which the Stop input does not affect."""
        poll_ns = round(options.input_poll_ms * _NS_PER_MS)
        self.inputs = InputLevels(
            time,
            round(options.input_filter_ms * _NS_PER_MS),
            poll_ns,
            round(poll_phase * poll_ns),
            self._inputs_changed,
        )
        self.outputs = UserOutputs()
        self.drive = drive
        self.modules = ExternalModules(options)
        self._values = OperandValues(MotorParameters(), self.inputs, self.drive, options.overflow_wraps)
        self._motor = MotorCommands(options, self._tempo, self.drive, self._values, self._abort_all)
        self._permanent = PermanentMemory()
        self._actions = StatementExecutor(
            options,
            self._tempo,
            self._store_tempo,
            StatementTargets(self._values, self._motor, self.outputs, self._permanent, self.modules),
            emit,
        )
        line_ns = round(options.line_ms * _NS_PER_MS)
        self._program = ProgramInterpreter(self._tempo, line_ns, self._values, self._actions, self._handle_program_end)
        self._queries = QueryAnswers(options, self._values, self.outputs)
        self._working = WorkingMemory()
        self._mode = IndexerMode.STANDBY
        self._direct = False
        """A command given in Standby is in progress."""
        self._storing = False
        """It is an access to the permanent memory, which cannot be interrupted."""
        self._fault: Code | None = None
        """Error that ended a program; reported by the next F (decision 26)."""
        self._first = options.power_up_e1
        self.on = True

    # State

    @property
    def is_busy(self) -> bool:
        """A program runs, a command given in Standby is in progress, or the motor turns."""
        return self._program.running or self._direct or self.drive.is_occupied

    @property
    def motor_parameters(self) -> MotorParameters:
        """Parameters of the next motor command."""
        return self._values.parameters

    # Power and environment

    def power_down(self) -> None:
        """Switch off: the motor stops dead; everything but the permanent memory is lost."""
        self.on = False
        self._abort_all()
        self.drive.discard_run()
        self.outputs.clear_outputs()

    def power_up(self) -> None:
        """Switch on with defaults and an empty working memory; with REC the permanent program runs (L1871-L1873)."""
        self.on = True
        self._values.parameters = MotorParameters()
        self._values.registers.values.clear()
        self._values.delay = 0
        self._motor.conversion.factor = None
        self._motor.conversion.remainder = 0
        self._working.clear_program()
        self._mode = IndexerMode.STANDBY
        self._fault = None
        self._first = self.options.power_up_e1
        self.drive.set_counter(0)
        self.inputs.power_up()
        if self.options.rec and not self.options.e2prom_fault:
            self._permanent.recall_program(self._working)
            self._program.start_program(self._working.lines)

    def set_stop_input(self, *, held: bool) -> None:
        """Set the Stop input: pulled to ground, or released (L830-L850)."""
        if held == self.drive.held:
            return
        if held:
            self._tempo.pause_timer()
            self.drive.set_stop_input(held=True)
        else:
            self._tempo.resume_timer()
            self.drive.set_stop_input(held=False)
            self._inputs_changed()

    def _inputs_changed(self) -> None:
        if self.on:
            self._motor.inputs_changed()
            self._program.inputs_changed()

    # Commands

    def handle_string(self, received: ReceivedString) -> None:
        """Answer one string."""
        if self._first:
            self._first = False
            self._emit("E1")
            return
        if not received.intact:
            self._emit("E1")
            return
        text = strip_blanks(received.text)
        if not text and self._mode is not IndexerMode.PROGRAMMING:
            return
        try:
            self._handle_command(text)
        except StatementRefused as refusal:
            self._emit(refusal.code)

    def _handle_command(self, text: str) -> None:
        match = _SYSTEM.fullmatch(text)
        name, argument = (match[1], match[2]) if match else ("", "")
        if self.is_busy and not self._is_accepted(name):
            self._emit("B")
            return
        if match is None:
            self._handle_statement(text, read_statement(text))
            return
        if argument and name not in ("VA", "VR"):
            raise StatementRefused("E2")
        if self._mode is IndexerMode.PROGRAMMING and name in _NOT_IN_PROGRAMMING:
            raise StatementRefused("E4")
        self._run_system_command(name, argument)

    def _is_accepted(self, name: str) -> bool:
        """Return whether a command is accepted while the device is busy."""
        if self._storing:
            return False
        return name in ("F", "K", "Z") or (name in ("V1", "V2") and self.options.live_verify)

    def _run_system_command(self, name: str, argument: str) -> None:
        match name:
            case "F":
                self._emit(self._format_status())
            case "K":
                self._abort_all()
                self.drive.discard_run()
                self.drive.overflow = False
                self._emit("Y")
            case "Z":
                self._abort_all()
                self.drive.ramp_down()
                self._emit("Y")
            case "E":
                self._mode = IndexerMode.STANDBY
                self._emit("Y")
                self._fault = None
                self._program.start_program(self._working.lines)
            case "PO":
                self._working.clear_program()
                self._mode = IndexerMode.PROGRAMMING
                self._emit("Y")
            case "PE":
                self._mode = IndexerMode.PROGRAMMING
                self._emit("Y")
            case "PX":
                self._mode = IndexerMode.STANDBY
                self._emit("Y")
            case "M":
                save = partial(self._permanent.save_program, self._working)
                self._access_memory(self._actions.access_memory(self.options.save_s, save))
            case "X":
                recall = partial(self._permanent.recall_program, self._working)
                self._access_memory(self._actions.access_memory(self.options.recall_s, recall))
            case "Q":
                for line in self._working.lines:
                    self._emit(line.text)
                self._emit("Y")
            case _:
                self._emit(self._queries.answer_query(name, argument))

    def _format_status(self) -> str:
        if self.is_busy:
            return "B"
        if self.drive.overflow:
            return "E5"
        fault, self._fault = self._fault, None
        return fault or "R"

    def _handle_statement(self, text: str, statement: Statement) -> None:
        if isinstance(statement, SetCurrent) and statement.milliamps > _MOST_MILLIAMPS[self.options.type]:
            raise StatementRefused("E4")
        if self._mode is IndexerMode.PROGRAMMING:
            self._working.append_line(StoredLine(text, statement))
            self._emit("Y")
            return
        if isinstance(statement, Flow | RunOn) or _is_loop_assignment(statement):
            raise StatementRefused("E4")
        if isinstance(statement, MoveSteps | MoveAnalogue | SearchHome) and not self.options.direct_moves:
            raise StatementRefused("E4")
        activity = self._actions.execute_statement(statement)
        if activity is not None and isinstance(statement, InitializeState):
            self._access_memory(activity)
            return
        self._emit("Y")
        if activity is not None:
            self._direct = True
            activity(self._finish_direct)

    def _access_memory(self, activity: Activity) -> None:
        """Access the permanent memory and answer at the end (decision 30)."""

        def finish_access() -> None:
            self._direct = self._storing = False
            self._emit("Y")

        self._direct = self._storing = True
        activity(finish_access)

    def _finish_direct(self) -> None:
        self._direct = False

    # End of programs and commands

    def _abort_all(self) -> None:
        """Return to Standby immediately (L1854)."""
        self._program.abort_program()
        self._motor.abort_motion()
        self._tempo.cancel_call()
        self._store_tempo.cancel_call()
        self._direct = self._storing = False
        self._mode = IndexerMode.STANDBY

    def _handle_program_end(self, code: Code | None) -> None:
        if code is not None:
            self._fault = code
            self._motor.armed = None


def _is_loop_assignment(statement: Statement) -> bool:
    """Return whether the statement is L=…, which is flow as well."""
    return isinstance(statement, AssignRegister) and statement.target == PredefinedRegister("L")
