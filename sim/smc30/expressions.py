"""Evaluation of operands at run time (L2968-L3004)."""

from collections.abc import Callable
from dataclasses import dataclass, field

from sim.smc30.drive import StepGenerator
from sim.smc30.inputs import InputLevels
from sim.smc30.memory import UserRegisters
from sim.smc30.operands import (
    LAST_REGISTER,
    WORD,
    AnalogueLevel,
    IndirectRegister,
    NumberLiteral,
    Operand,
    PredefinedRegister,
    UserRegister,
)
from sim.smc30.parameters import MotorParameters
from sim.smc30.refusal import StatementRefused
from sim.smc30.statements import AssignRegister, IfComparison, Operator

_SIGNED = 32_767


@dataclass(slots=True)
class OperandValues:
    """All values that an operand can refer to."""

    parameters: MotorParameters
    inputs: InputLevels
    drive: StepGenerator
    wraps: bool
    """Arithmetic wraps modulo 65536 (decision 26)."""
    registers: UserRegisters = field(default_factory=UserRegisters)
    delay: int = 0
    """Register D: the last delay, 1/100 s."""
    loops_left: Callable[[], int] = lambda: 0
    """Register L: repetitions left of the innermost loop."""

    def read_operand(self, operand: Operand) -> int:
        """Return the operand's value 0-65535; E4 for a register that does not exist or a negative counter (decision
        27)."""
        if isinstance(operand, NumberLiteral):
            return operand.value
        if isinstance(operand, UserRegister):
            return self.registers.read_register(operand.number)
        if isinstance(operand, IndirectRegister):
            return self.registers.read_register(self.pointed_register(operand))
        if isinstance(operand, AnalogueLevel):
            return self.inputs.analogue_level(operand.input)
        return self._to_word(self._read_predefined(operand))

    def pointed_register(self, operand: IndirectRegister) -> int:
        """Return the number of the register that an indirect operand refers to."""
        number = self.registers.read_register(operand.pointer)
        if not 1 <= number <= LAST_REGISTER:
            raise StatementRefused("E4")
        return number

    def _read_predefined(self, operand: PredefinedRegister) -> int:
        match operand.letter:
            case "R":
                return self.parameters.ramp_steps
            case "S":
                return self.parameters.start
            case "T":
                return self.parameters.top
            case "D":
                return self.delay
            case "L":
                return self.loops_left()
            case "n":
                return self.drive.position_counter

    def _to_word(self, value: int) -> int:
        if 0 <= value <= WORD:
            return value
        if self.wraps:
            return value % (WORD + 1)
        raise StatementRefused("E4")

    def assigned_value(self, statement: AssignRegister) -> int:
        """Return the right side of an assignment."""
        operand_left = self.read_operand(statement.left)
        if statement.operator is None or statement.right is None:
            return operand_left
        return self._to_word(_apply_operator(statement.operator, operand_left, self.read_operand(statement.right)))

    def is_true(self, statement: IfComparison) -> bool:
        """Return whether a comparison is true; its operands are at most 32767 (L3003)."""
        first_value, second_value = self.read_operand(statement.left), self.read_operand(statement.right)
        if max(first_value, second_value) > _SIGNED:
            raise StatementRefused("E4")
        match statement.comparison:
            case "<":
                return first_value < second_value
            case ">":
                return first_value > second_value
            case "=":
                return first_value == second_value
            case "<=":
                return first_value <= second_value
            case ">=":
                return first_value >= second_value
            case "<>":
                return first_value != second_value


def _apply_operator(operator: Operator, left: int, right: int) -> int:
    match operator:
        case "+":
            return left + right
        case "-":
            return left - right
        case "*":
            return left * right
        case "/":
            if not right or max(left, right) > _SIGNED:
                raise StatementRefused("E4")
            return left // right
