"""One SMC30: its modes, and what it answers (L1369-L1573)."""

import re
from collections.abc import Callable
from enum import Enum, auto
from typing import Literal

from sim.core.controller import Motion
from sim.core.devicetime import DeviceTime
from sim.smc30.actions import Actions
from sim.smc30.drive import Drive
from sim.smc30.expressions import Values
from sim.smc30.framing import Received
from sim.smc30.inputs import ANALOGUE_INPUTS, Inputs
from sim.smc30.memory import PermanentMemory, WorkingMemory
from sim.smc30.modules import Modules
from sim.smc30.motor import Activity, MotorCommands
from sim.smc30.operands import LAST_REGISTER, Predefined, bounded
from sim.smc30.options import UnitOptions
from sim.smc30.outputs import Outputs
from sim.smc30.parameters import Parameters
from sim.smc30.parser import compact, read_statement
from sim.smc30.program import Program
from sim.smc30.refusal import Code, Refused
from sim.smc30.statements import (
    Assign,
    Contact,
    Flow,
    Home,
    Initialize,
    Line,
    Move,
    MoveAnalogue,
    RunOn,
    SetCurrent,
    Statement,
)
from sim.smc30.tempo import Tempo

_NS_PER_MS = 1_000_000
_SYSTEM = re.compile(r"(PE|PO|PX|TP|V1|V2|VS|VT|VR|VA|[EFKMQXZ])([+-]?\d*)")
_MOST_MILLIAMPS = {"SMC30B": 6000, "SMC30C": 12_000}
"""Highest current of CS, CR and CT (L2008)."""
_NOT_IN_PROGRAMMING = frozenset(("M", "X", "V1", "V2"))
"""Not accepted in Programming Mode: neither storable nor documented there (L2459)."""


class Mode(Enum):
    """Standby and Programming; Execute is when the program runs."""

    STANDBY = auto()
    PROGRAMMING = auto()


class Unit:
    """A unit and what is connected to it. `emit` takes a reply without checksum and CR.

    poll_phase: where in its period the firmware looks at the user inputs, 0 to 1.
    """

    def __init__(
        self,
        time: DeviceTime,
        options: UnitOptions,
        axis: str,
        motions: list[Motion],
        emit: Callable[[str], None],
        poll_phase: float = 0.0,
    ) -> None:
        self.axis = axis
        self.time = time
        self.options = options
        self._emit = emit
        self._tempo = Tempo(time)
        self._store_tempo = Tempo(time)
        """Of the permanent memory, which the Stop input does not concern."""
        poll_ns = round(options.input_poll_ms * _NS_PER_MS)
        self.inputs = Inputs(
            time,
            round(options.input_filter_ms * _NS_PER_MS),
            poll_ns,
            round(poll_phase * poll_ns),
            self._inputs_changed,
        )
        self.outputs = Outputs()
        self.drive = Drive(time, axis, motions, options.travel_steps)
        self.modules = Modules(options)
        self._values = Values(Parameters(), self.inputs, self.drive, options.overflow_wraps)
        self._motor = MotorCommands(options, self._tempo, self.drive, self._values, self._abort)
        self._permanent = PermanentMemory()
        self._actions = Actions(
            options,
            self._tempo,
            self._store_tempo,
            self._values,
            self._motor,
            self.outputs,
            self._permanent,
            self.modules,
            emit,
        )
        line_ns = round(options.line_ms * _NS_PER_MS)
        self._program = Program(time, self._tempo, line_ns, self._values, self._actions, self._program_over)
        self._working = WorkingMemory()
        self._mode = Mode.STANDBY
        self._direct = False
        """A command given in Standby goes on."""
        self._storing = False
        """It is an access to the permanent memory, which nothing interrupts."""
        self._fault: Code | None = None
        """Why a program has ended; told by the next F (decision 26)."""
        self._first = options.power_up_e1
        self.on = True

    # State

    @property
    def busy(self) -> bool:
        """A program runs, or a command given in Standby goes on, or the motor turns."""
        return self._program.running or self._direct or self.drive.occupied

    @property
    def parameters(self) -> Parameters:
        """What the next motor command would use."""
        return self._values.parameters

    # Power and the world

    def power_down(self) -> None:
        """The motor stops dead; all but the permanent memory is lost."""
        self.on = False
        self._abort()
        self.drive.kill()
        self.outputs.clear()

    def power_up(self) -> None:
        """Defaults and an empty working memory; with REC the permanent program runs (L1871-L1873)."""
        self.on = True
        self._values.parameters = Parameters()
        self._values.registers.values.clear()
        self._values.delay = 0
        self._motor.conversion.factor = None
        self._motor.conversion.remainder = 0
        self._working.clear()
        self._mode = Mode.STANDBY
        self._fault = None
        self._first = self.options.power_up_e1
        self.drive.set_counter(0)
        self.inputs.power_up()
        if self.options.rec and not self.options.e2prom_fault:
            self._working.load(self._permanent.program)
            self._program.start(self._working.lines)

    def hold(self, held: bool) -> None:
        """The Stop input pulled to ground, or released (L830-L850)."""
        if held == self.drive.held:
            return
        if held:
            self._tempo.halt()
            self.drive.hold(True)
        else:
            self._tempo.resume()
            self.drive.hold(False)
            self._inputs_changed()

    def _inputs_changed(self) -> None:
        if self.on:
            self._motor.inputs_changed()
            self._program.inputs_changed()

    # Commands

    def take(self, received: Received) -> None:
        """Answer one string."""
        if self._first:
            self._first = False
            self._emit("E1")
            return
        if not received.intact:
            self._emit("E1")
            return
        text = compact(received.text)
        if not text and self._mode is not Mode.PROGRAMMING:
            return
        try:
            self._command(text)
        except Refused as refusal:
            self._emit(refusal.code)

    def _command(self, text: str) -> None:
        match = _SYSTEM.fullmatch(text)
        name, argument = (match[1], match[2]) if match else ("", "")
        if self.busy and not self._heard(name):
            self._emit("B")
            return
        if match is None:
            self._statement(text, read_statement(text))
            return
        if argument and name not in ("VA", "VR"):
            raise Refused("E2")
        if self._mode is Mode.PROGRAMMING and name in _NOT_IN_PROGRAMMING:
            raise Refused("E4")
        self._system(name, argument)

    def _heard(self, name: str) -> bool:
        """Whether a command is taken while the unit is busy."""
        if self._storing:
            return False
        return name in ("F", "K", "Z") or (name in ("V1", "V2") and self.options.live_verify)

    def _system(self, name: str, argument: str) -> None:
        match name:
            case "F":
                self._emit(self._status())
            case "K":
                self._abort()
                self.drive.kill()
                self.drive.overflow = False
                self._emit("Y")
            case "Z":
                self._abort()
                self.drive.ramp_down()
                self._emit("Y")
            case "E":
                self._mode = Mode.STANDBY
                self._emit("Y")
                self._fault = None
                self._program.start(self._working.lines)
            case "PO":
                self._working.clear()
                self._mode = Mode.PROGRAMMING
                self._emit("Y")
            case "PE":
                self._mode = Mode.PROGRAMMING
                self._emit("Y")
            case "PX":
                self._mode = Mode.STANDBY
                self._emit("Y")
            case "M":
                self._store(self._actions.lasting(self.options.save_s, self._save))
            case "X":
                self._store(self._actions.lasting(self.options.recall_s, self._recall))
            case "Q":
                for line in self._working.lines:
                    self._emit(line.text)
                self._emit("Y")
            case _:
                self._emit(self._verified(name, argument))

    def _status(self) -> str:
        if self.busy:
            return "B"
        if self.drive.overflow:
            return "E5"
        fault, self._fault = self._fault, None
        return fault or "R"

    def _verified(self, name: str, argument: str) -> str:
        """The answer to a query (L1914-L1931, L2349-L2487, L3006-L3015; decisions 7-10)."""
        parameters = self._values.parameters
        match name:
            case "V1":
                return f"V{self.drive.counter:+d}"
            case "V2":
                return f"V{self.inputs.pattern()}{self.outputs.pattern()}"
            case "VS":
                return f"S{parameters.start}"
            case "VT":
                return f"T{parameters.top}"
            case "VR" if not argument:
                return f"R{parameters.ramp}"
            case "VR":
                number = bounded(argument, 0, LAST_REGISTER) if argument.isdigit() else _refuse("E4")
                return f"R{number}={self._values.registers.read(number)}"
            case "VA" if not argument:
                contacts = (Contact(number, analogue=True) for number in range(1, ANALOGUE_INPUTS + 1))
                return "VA" + "".join("1" if self.inputs.closed(contact) else "0" for contact in contacts)
            case "VA":
                number = bounded(argument, 1, ANALOGUE_INPUTS) if argument.isdigit() else _refuse("E4")
                return f"VA{number}={self.inputs.analogue(number) * 2 / 100:.2f}"
            case _:
                return f"TP{self.options.temperature_c}"

    def _statement(self, text: str, statement: Statement) -> None:
        if isinstance(statement, SetCurrent) and statement.milliamps > _MOST_MILLIAMPS[self.options.type]:
            raise Refused("E4")
        if self._mode is Mode.PROGRAMMING:
            self._working.append(Line(text, statement))
            self._emit("Y")
            return
        if isinstance(statement, Flow | RunOn) or _loops(statement):
            raise Refused("E4")
        if isinstance(statement, Move | MoveAnalogue | Home) and not self.options.direct_moves:
            raise Refused("E4")
        activity = self._actions.perform(statement)
        if activity is not None and isinstance(statement, Initialize):
            self._store(activity)
            return
        self._emit("Y")
        if activity is not None:
            self._direct = True
            activity(self._direct_over)

    def _store(self, activity: Activity) -> None:
        """Access the permanent memory and answer at the end (decision 30)."""

        def over() -> None:
            self._direct = self._storing = False
            self._emit("Y")

        self._direct = self._storing = True
        activity(over)

    def _direct_over(self) -> None:
        self._direct = False

    def _save(self) -> None:
        self._permanent.program = list(self._working.lines)

    def _recall(self) -> None:
        self._working.load(self._permanent.program)

    # Ends

    def _abort(self) -> None:
        """Standby at once (L1854)."""
        self._program.abort()
        self._motor.abort()
        self._tempo.cancel()
        self._store_tempo.cancel()
        self._direct = self._storing = False
        self._mode = Mode.STANDBY

    def _program_over(self, code: Code | None) -> None:
        if code is not None:
            self._fault = code
            self._motor.armed = None


def _loops(statement: Statement) -> bool:
    """L=…, which is flow as well."""
    return isinstance(statement, Assign) and statement.target == Predefined("L")


def _refuse(code: Literal["E4"]) -> int:
    raise Refused(code)
