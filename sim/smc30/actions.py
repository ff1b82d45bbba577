"""Execution of the commands that are not program flow, in a program and directly."""

from collections.abc import Callable

from sim.smc30.expressions import OperandValues
from sim.smc30.memory import PermanentMemory
from sim.smc30.modules import ExternalModules
from sim.smc30.motor import Activity, Done, MotorCommands
from sim.smc30.operands import IndirectRegister, Operand, PredefinedRegister, Target, UserRegister
from sim.smc30.options import IndexerOptions
from sim.smc30.outputs import UserOutputs
from sim.smc30.refusal import StatementRefused
from sim.smc30.statements import (
    Act,
    ArmMove,
    AssignRegister,
    BlankLine,
    DelayAnalogue,
    DelayTicks,
    ForceCounter,
    InitializeState,
    MoveAnalogue,
    MoveSteps,
    PrintText,
    RateFromAnalogue,
    ReadInput,
    RunOn,
    SearchHome,
    SetConversion,
    SetCurrent,
    SetFlag,
    SetOutput,
    SetRate,
)
from sim.smc30.tempo import PausableTimer

_NS_PER_TICK = 10_000_000
_LAST_DELAY = 32_000
_PC = 255
_NS_PER_S = 1_000_000_000


class StatementExecutor:
    """Executes one statement at a time."""

    def __init__(
        self,
        options: IndexerOptions,
        tempo: PausableTimer,
        store_tempo: PausableTimer,
        values: OperandValues,
        motor: MotorCommands,
        outputs: UserOutputs,
        permanent: PermanentMemory,
        modules: ExternalModules,
        send: Callable[[str], None],
    ) -> None:
        self._options = options
        self._tempo = tempo
        self._store_tempo = store_tempo
        self._values = values
        self._motor = motor
        self._outputs = outputs
        self._permanent = permanent
        self._modules = modules
        self._send_reply = send

    def execute_statement(self, statement: Act) -> Activity | None:
        """Execute it, or return the activity that takes time. `StatementRefused` when it cannot be done."""
        values = self._values
        match statement:
            case MoveSteps() | MoveAnalogue() | RunOn() | SearchHome():
                return self._motor.prepare_motion(statement)
            case DelayTicks(ticks):
                return self._begin_delay(ticks)
            case DelayAnalogue(ticks):
                return self._begin_delay(values.inputs.scale_level(ticks))
            case AssignRegister():
                return self._assign_value(statement.target, values.assigned_value(statement))
            case InitializeState(what):
                return self._initialize_state(what)
            case PrintText():
                return self._print_statement(statement)
            case ReadInput():
                return self._assign_value(statement.target, self._modules.read_input(statement))
            case BlankLine():
                pass
            case ForceCounter(position):
                values.drive.set_counter(position)
            case ArmMove():
                self._motor.armed = statement
            case SetCurrent(which, milliamps):
                values.parameters.currents_ma[which] = milliamps
            case SetRate(rate, value):
                values.parameters.set_rate(rate, value)
            case RateFromAnalogue(rate, input_, scale):
                values.parameters.set_from_analogue(rate, values.inputs.analogue_level(input_), scale)
            case SetOutput(number, on):
                self._outputs.set_output(number, on)
            case SetConversion(factor):
                self._motor.conversion.factor = factor
            case SetFlag():
                self._modules.set_flag(statement)
        return None

    def _begin_delay(self, ticks: int) -> Activity:
        if ticks > _LAST_DELAY:
            raise StatementRefused("E4")
        self._values.delay = ticks
        return lambda done: self._tempo.call_after(ticks * _NS_PER_TICK, done) if ticks else done()

    def _assign_value(self, target: Target, value: int) -> Activity | None:
        match target:
            case UserRegister(number):
                self._values.registers.write_register(number, value)
            case IndirectRegister():
                self._values.registers.write_register(self._values.pointed_register(target), value)
            case PredefinedRegister("D"):
                return self._begin_delay(value)
            case PredefinedRegister("R" | "S" | "T" as rate):
                self._values.parameters.set_rate(rate, value)
            case PredefinedRegister():
                # L is flow and n is never a target: both are handled earlier.
                raise StatementRefused("E4")
        return None

    def _initialize_state(self, what: int) -> Activity | None:
        values = self._values
        if what in (1, 3):
            values.drive.set_counter(0)
        if what in (2, 3):
            self._outputs.clear_outputs()
        if what == 5:
            values.registers.values.clear()
        if what == 6:
            return self.access_memory(self._options.save_s, self._save_registers)
        if what == 7:
            return self.access_memory(self._options.recall_s, self._recall_registers)
        return None

    def access_memory(self, seconds: float, effect: Callable[[], None]) -> Activity:
        """Access the permanent memory, which takes `seconds`; E6 when it is broken."""
        if self._options.e2prom_fault:
            raise StatementRefused("E6")

        def begin_access(done: Done) -> None:
            def finish_access() -> None:
                effect()
                done()

            if seconds:
                self._store_tempo.call_after(round(seconds * _NS_PER_S), finish_access)
            else:
                finish_access()

        return begin_access

    def _save_registers(self) -> None:
        self._permanent.registers = dict(self._values.registers.values)

    def _recall_registers(self) -> None:
        self._values.registers.values = dict(self._permanent.registers)

    def _print_statement(self, statement: PrintText) -> Activity:
        text = self._format_operand(statement.what)

        def begin_print(done: Done) -> None:
            if statement.module == _PC:
                self._send_reply(text)
            else:
                self._modules.show_text(statement, text)
            done()

        return begin_print

    def _format_operand(self, what: Operand | str) -> str:
        return what if isinstance(what, str) else str(self._values.read_operand(what))
