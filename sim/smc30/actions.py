"""What the commands that are not program flow do, in a program and directly."""

from collections.abc import Callable

from sim.smc30.expressions import Values
from sim.smc30.memory import PermanentMemory
from sim.smc30.modules import Modules
from sim.smc30.motor import Activity, Done, MotorCommands
from sim.smc30.operands import Indirect, Operand, Predefined, Target, User
from sim.smc30.options import UnitOptions
from sim.smc30.outputs import Outputs
from sim.smc30.refusal import Refused
from sim.smc30.statements import (
    Act,
    Arm,
    Assign,
    Blank,
    Convert,
    Delay,
    DelayAnalogue,
    Flag,
    Force,
    Home,
    Initialize,
    Input,
    Move,
    MoveAnalogue,
    Output,
    Print,
    RateFromAnalogue,
    RunOn,
    SetCurrent,
    SetRate,
)
from sim.smc30.tempo import Tempo

_NS_PER_TICK = 10_000_000
_LAST_DELAY = 32_000
_PC = 255
_NS_PER_S = 1_000_000_000


class Actions:
    """Executes one statement at a time."""

    def __init__(
        self,
        options: UnitOptions,
        tempo: Tempo,
        store_tempo: Tempo,
        values: Values,
        motor: MotorCommands,
        outputs: Outputs,
        permanent: PermanentMemory,
        modules: Modules,
        say: Callable[[str], None],
    ) -> None:
        self._options = options
        self._tempo = tempo
        self._store_tempo = store_tempo
        self._values = values
        self._motor = motor
        self._outputs = outputs
        self._permanent = permanent
        self._modules = modules
        self._say = say

    def perform(self, statement: Act) -> Activity | None:
        """Do it, or give what takes time. `Refused` when it cannot be done."""
        values = self._values
        match statement:
            case Move() | MoveAnalogue() | RunOn() | Home():
                return self._motor.prepare(statement)
            case Delay(ticks):
                return self._delay(ticks)
            case DelayAnalogue(ticks):
                return self._delay(values.inputs.scaled(ticks))
            case Assign():
                return self._assign(statement.target, values.assigned(statement))
            case Initialize(what):
                return self._initialize(what)
            case Print():
                return self._print(statement)
            case Input():
                return self._assign(statement.target, self._modules.read(statement))
            case Blank():
                pass
            case Force(position):
                values.drive.set_counter(position)
            case Arm():
                self._motor.armed = statement
            case SetCurrent(which, milliamps):
                values.parameters.currents_ma[which] = milliamps
            case SetRate(rate, value):
                values.parameters.set(rate, value)
            case RateFromAnalogue(rate, input_, scale):
                values.parameters.set_from_analogue(rate, values.inputs.analogue(input_), scale)
            case Output(number, on):
                self._outputs.set(number, on)
            case Convert(factor):
                self._motor.conversion.factor = factor
            case Flag():
                self._modules.flag(statement)
        return None

    def _delay(self, ticks: int) -> Activity:
        if ticks > _LAST_DELAY:
            raise Refused("E4")
        self._values.delay = ticks
        return lambda done: self._tempo.after(ticks * _NS_PER_TICK, done) if ticks else done()

    def _assign(self, target: Target, value: int) -> Activity | None:
        match target:
            case User(number):
                self._values.registers.write(number, value)
            case Indirect():
                self._values.registers.write(self._values.pointed(target), value)
            case Predefined("D"):
                return self._delay(value)
            case Predefined("R" | "S" | "T" as rate):
                self._values.parameters.set(rate, value)
            case Predefined():
                # L is flow and n is never a target: both are sorted out before.
                raise Refused("E4")
        return None

    def _initialize(self, what: int) -> Activity | None:
        values = self._values
        if what in (1, 3):
            values.drive.set_counter(0)
        if what in (2, 3):
            self._outputs.clear()
        if what == 5:
            values.registers.values.clear()
        if what == 6:
            return self.lasting(self._options.save_s, self._save_registers)
        if what == 7:
            return self.lasting(self._options.recall_s, self._recall_registers)
        return None

    def lasting(self, seconds: float, effect: Callable[[], None]) -> Activity:
        """Access to the permanent memory, which takes `seconds`; E6 when it is broken."""
        if self._options.e2prom_fault:
            raise Refused("E6")

        def begin(done: Done) -> None:
            def over() -> None:
                effect()
                done()

            if seconds:
                self._store_tempo.after(round(seconds * _NS_PER_S), over)
            else:
                over()

        return begin

    def _save_registers(self) -> None:
        self._permanent.registers = dict(self._values.registers.values)

    def _recall_registers(self) -> None:
        self._values.registers.values = dict(self._permanent.registers)

    def _print(self, statement: Print) -> Activity:
        text = self._printed(statement.what)

        def begin(done: Done) -> None:
            if statement.module == _PC:
                self._say(text)
            else:
                self._modules.show(statement, text)
            done()

        return begin

    def _printed(self, what: Operand | str) -> str:
        return what if isinstance(what, str) else str(self._values.read(what))
