"""What operands are worth at run time (L2968-L3004)."""

from collections.abc import Callable
from dataclasses import dataclass, field

from sim.smc30.drive import Drive
from sim.smc30.inputs import Inputs
from sim.smc30.memory import Registers
from sim.smc30.operands import LAST_REGISTER, WORD, Analogue, Indirect, Number, Operand, Predefined, User
from sim.smc30.parameters import Parameters
from sim.smc30.refusal import Refused
from sim.smc30.statements import Assign, If, Operator

_SIGNED = 32_767


@dataclass(slots=True)
class Values:
    """Everything that an operand can name."""

    parameters: Parameters
    inputs: Inputs
    drive: Drive
    wraps: bool
    """Arithmetic wraps modulo 65536 (decision 26)."""
    registers: Registers = field(default_factory=Registers)
    delay: int = 0
    """Register D: the last delay, 1/100 s."""
    loops_left: Callable[[], int] = lambda: 0
    """Register L: repetitions left of the innermost loop."""

    def read(self, operand: Operand) -> int:
        """The operand's value 0-65535; E4 for a register that does not exist or a negative counter (decision 27)."""
        if isinstance(operand, Number):
            return operand.value
        if isinstance(operand, User):
            return self.registers.read(operand.number)
        if isinstance(operand, Indirect):
            return self.registers.read(self.pointed(operand))
        if isinstance(operand, Analogue):
            return self.inputs.analogue(operand.input)
        return self._word(self._predefined(operand))

    def pointed(self, operand: Indirect) -> int:
        """The number of the register that an indirect operand means."""
        number = self.registers.read(operand.pointer)
        if not 1 <= number <= LAST_REGISTER:
            raise Refused("E4")
        return number

    def _predefined(self, operand: Predefined) -> int:
        match operand.letter:
            case "R":
                return self.parameters.ramp
            case "S":
                return self.parameters.start
            case "T":
                return self.parameters.top
            case "D":
                return self.delay
            case "L":
                return self.loops_left()
            case "n":
                return self.drive.counter

    def _word(self, value: int) -> int:
        if 0 <= value <= WORD:
            return value
        if self.wraps:
            return value % (WORD + 1)
        raise Refused("E4")

    def assigned(self, statement: Assign) -> int:
        """The right side of an assignment."""
        left = self.read(statement.left)
        if statement.operator is None or statement.right is None:
            return left
        return self._word(_calculate(statement.operator, left, self.read(statement.right)))

    def holds(self, statement: If) -> bool:
        """Whether a comparison is true; its operands are at most 32767 (L3003)."""
        left, right = self.read(statement.left), self.read(statement.right)
        if max(left, right) > _SIGNED:
            raise Refused("E4")
        match statement.comparison:
            case "<":
                return left < right
            case ">":
                return left > right
            case "=":
                return left == right
            case "<=":
                return left <= right
            case ">=":
                return left >= right
            case "<>":
                return left != right


def _calculate(operator: Operator, left: int, right: int) -> int:
    match operator:
        case "+":
            return left + right
        case "-":
            return left - right
        case "*":
            return left * right
        case "/":
            if not right or max(left, right) > _SIGNED:
                raise Refused("E4")
            return left // right
