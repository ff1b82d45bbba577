"""Execution of the commands that are not program flow, in a program and directly."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import singledispatchmethod

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


@dataclass(frozen=True, slots=True)
class StatementTargets:
    """Parts of the device that statements act on."""

    values: OperandValues
    motor: MotorCommands
    outputs: UserOutputs
    permanent: PermanentMemory
    modules: ExternalModules


class StatementExecutor:
    """Executes one statement at a time."""

    def __init__(
        self,
        options: IndexerOptions,
        tempo: PausableTimer,
        store_tempo: PausableTimer,
        targets: StatementTargets,
        send: Callable[[str], None],
    ) -> None:
        self._options = options
        self._tempo = tempo
        self._store_tempo = store_tempo
        self._values = targets.values
        self._targets = targets
        self._send_reply = send

    @singledispatchmethod
    def execute_statement(self, statement: Act) -> Activity | None:
        """Execute it, or return the activity that takes time. `StatementRefused` when it cannot be done."""
        raise TypeError(f"{type(statement).__name__} is not a statement that is executed here")

    @execute_statement.register
    def _move_motor(self, statement: MoveSteps | MoveAnalogue | RunOn | SearchHome) -> Activity | None:
        return self._targets.motor.prepare_motion(statement)

    @execute_statement.register
    def _delay_ticks(self, statement: DelayTicks) -> Activity | None:
        return self._begin_delay(statement.ticks)

    @execute_statement.register
    def _delay_analogue(self, statement: DelayAnalogue) -> Activity | None:
        return self._begin_delay(self._values.inputs.scale_level(statement.ticks))

    @execute_statement.register
    def _assign_register(self, statement: AssignRegister) -> Activity | None:
        return self._assign_value(statement.target, self._values.assigned_value(statement))

    @execute_statement.register
    def _read_input(self, statement: ReadInput) -> Activity | None:
        return self._assign_value(statement.target, self._targets.modules.read_input(statement))

    @execute_statement.register
    def _skip_blank(self, statement: BlankLine) -> Activity | None:
        return None

    @execute_statement.register
    def _force_counter(self, statement: ForceCounter) -> Activity | None:
        self._values.drive.set_counter(statement.position)

    @execute_statement.register
    def _arm_move(self, statement: ArmMove) -> Activity | None:
        self._targets.motor.armed = statement

    @execute_statement.register
    def _set_current(self, statement: SetCurrent) -> Activity | None:
        self._values.parameters.currents_ma[statement.which] = statement.milliamps

    @execute_statement.register
    def _set_rate(self, statement: SetRate) -> Activity | None:
        self._values.parameters.set_rate(statement.rate, statement.value)

    @execute_statement.register
    def _rate_from_analogue(self, statement: RateFromAnalogue) -> Activity | None:
        level = self._values.inputs.analogue_level(statement.input)
        self._values.parameters.set_from_analogue(statement.rate, level, statement.scale)

    @execute_statement.register
    def _set_output(self, statement: SetOutput) -> Activity | None:
        self._targets.outputs.set_output(statement.number, on=statement.on)

    @execute_statement.register
    def _set_conversion(self, statement: SetConversion) -> Activity | None:
        self._targets.motor.conversion.factor = statement.factor

    @execute_statement.register
    def _set_flag(self, statement: SetFlag) -> Activity | None:
        self._targets.modules.set_flag(statement)

    def _begin_delay(self, ticks: int) -> Activity:
        if ticks > _LAST_DELAY:
            raise StatementRefused("E4")
        self._values.delay = ticks
        return lambda on_end: self._tempo.call_after(ticks * _NS_PER_TICK, on_end) if ticks else on_end()

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

    @execute_statement.register
    def _initialize_state(self, statement: InitializeState) -> Activity | None:
        values, kind = self._values, statement.what
        if kind in (1, 3):
            values.drive.set_counter(0)
        if kind in (2, 3):
            self._targets.outputs.clear_outputs()
        if kind == 5:
            values.registers.values.clear()
        if kind == 6:
            return self.access_memory(self._options.save_s, self._save_registers)
        if kind == 7:
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
        self._targets.permanent.registers = dict(self._values.registers.values)

    def _recall_registers(self) -> None:
        self._values.registers.values = dict(self._targets.permanent.registers)

    @execute_statement.register
    def _print_text(self, statement: PrintText) -> Activity:
        text = self._format_operand(statement.what)

        def begin_print(done: Done) -> None:
            if statement.module == _PC:
                self._send_reply(text)
            else:
                self._targets.modules.show_text(statement, text)
            done()

        return begin_print

    def _format_operand(self, what: Operand | str) -> str:
        return what if isinstance(what, str) else str(self._values.read_operand(what))
