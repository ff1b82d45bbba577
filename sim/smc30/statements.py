"""The commands that a program can contain, and the bytes each takes in working memory (L3642-L3703)."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from sim.smc30.operands import Operand, Target
from sim.smc30.parameters import Rate

Comparison = Literal["<", ">", "=", "<=", ">=", "<>"]
Operator = Literal["+", "-", "*", "/"]


@dataclass(frozen=True, slots=True)
class InputContact:
    """A digital input: user input 1-3, or analogue input 1-6 with threshold 2.5 V (L2731)."""

    number: int
    analogue: bool = False


@dataclass(frozen=True, slots=True)
class AnalogueThreshold:
    """Analogue input at or above (`>`), or below, a reference 0-255 (L2225-L2246, L2751-L2753)."""

    input: int
    above: bool
    reference: int


@dataclass(frozen=True, slots=True)
class InputLevel:
    """User input at a level."""

    input: int
    level: bool


@dataclass(frozen=True, slots=True)
class FallingInput:
    """User input going from logic 1 to logic 0 (L2114)."""

    input: int


StartCondition = InputLevel | AnalogueThreshold
StopCondition = InputLevel | FallingInput | AnalogueThreshold


@dataclass(frozen=True, slots=True)
class ScaledInput:
    """n1 at 0 V, n2 at 5.10 V of an analogue input, linear between."""

    input: int
    at_zero: int
    at_full: int


@dataclass(frozen=True, slots=True)
class BlankLine:
    size: ClassVar[int] = 1


@dataclass(frozen=True, slots=True)
class ForceCounter:
    """f: set the position counter, steps."""

    size: ClassVar[int] = 4
    position: int


@dataclass(frozen=True, slots=True)
class InitializeState:
    """I1-I3: counter, outputs; I5-I7: registers."""

    size: ClassVar[int] = 2
    what: int


@dataclass(frozen=True, slots=True)
class MoveSteps:
    """+ or - or G by a number or a register: units of the conversion factor."""

    size: ClassVar[int] = 4
    sign: int
    absolute: bool
    amount: int | Operand


@dataclass(frozen=True, slots=True)
class MoveAnalogue:
    size: ClassVar[int] = 6
    sign: int
    absolute: bool
    amount: ScaledInput


@dataclass(frozen=True, slots=True)
class RunOn:
    """g: continuous run."""

    size: ClassVar[int] = 1
    sign: int


@dataclass(frozen=True, slots=True)
class SearchHome:
    size: ClassVar[int] = 1
    sign: int


@dataclass(frozen=True, slots=True)
class ArmMove:
    """N, NA: start and stop conditions of the next motor command; None: unconditional, or no stop."""

    size: int
    start: StartCondition | None
    stop: StopCondition | None


@dataclass(frozen=True, slots=True)
class SetCurrent:
    size: ClassVar[int] = 3
    which: str
    milliamps: int


@dataclass(frozen=True, slots=True)
class SetRate:
    size: ClassVar[int] = 3
    rate: Rate
    value: int


@dataclass(frozen=True, slots=True)
class RateFromAnalogue:
    """r, s, t."""

    size: ClassVar[int] = 2
    rate: Literal["R", "S", "T"]
    input: int
    scale: int


@dataclass(frozen=True, slots=True)
class SetOutput:
    """A, C."""

    size: ClassVar[int] = 2
    number: int
    on: bool


@dataclass(frozen=True, slots=True)
class RepeatUntil:
    """U: jump back until the input is logic 0."""

    size: ClassVar[int] = 2
    contact: InputContact


@dataclass(frozen=True, slots=True)
class WaitFor:
    """W: wait until the input is logic 1."""

    size: ClassVar[int] = 2
    contact: InputContact


@dataclass(frozen=True, slots=True)
class DelayTicks:
    """D: 1/100 s."""

    size: ClassVar[int] = 3
    ticks: int


@dataclass(frozen=True, slots=True)
class DelayAnalogue:
    size: ClassVar[int] = 6
    ticks: ScaledInput


@dataclass(frozen=True, slots=True)
class JumpToLine:
    size: ClassVar[int] = 2
    line: int


@dataclass(frozen=True, slots=True)
class JumpPattern:
    """JC: if the three user inputs are exactly `pattern`, bit 0 = input 1 (L2602-L2613)."""

    size: ClassVar[int] = 4
    pattern: int
    line: int


@dataclass(frozen=True, slots=True)
class JumpLevel:
    size: ClassVar[int] = 4
    contact: InputContact
    level: bool
    line: int


@dataclass(frozen=True, slots=True)
class JumpThreshold:
    size: ClassVar[int] = 4
    threshold: AnalogueThreshold
    line: int


@dataclass(frozen=True, slots=True)
class CallSubroutine:
    """JS."""

    size: ClassVar[int] = 2
    line: int


@dataclass(frozen=True, slots=True)
class ReturnFromCall:
    size: ClassVar[int] = 1


@dataclass(frozen=True, slots=True)
class LoopSegment:
    """L0 begins a segment, Ln ends it and repeats it n times."""

    size: ClassVar[int] = 2
    count: int


@dataclass(frozen=True, slots=True)
class AssignRegister:
    target: Target
    left: Operand
    operator: Operator | None = None
    right: Operand | None = None

    @property
    def size(self) -> int:
        return 12 if self.right is None else 14


@dataclass(frozen=True, slots=True)
class SetConversion:
    """con: steps per unit, in ten-thousandths."""

    size: ClassVar[int] = 5
    factor: int


@dataclass(frozen=True, slots=True)
class PrintText:
    size: ClassVar[int] = 10
    module: int
    place: int
    what: Operand | str


@dataclass(frozen=True, slots=True)
class IfComparison:
    size: ClassVar[int] = 17
    left: Operand
    comparison: Comparison
    right: Operand


@dataclass(frozen=True, slots=True)
class ReadInput:
    """INPUT: read a module's register; `allowed` is the range check."""

    size: ClassVar[int] = 12
    target: Target
    module: int
    register: int
    allowed: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class SetFlag:
    """AO, CO."""

    size: ClassVar[int] = 3
    module: int
    flag: int
    on: bool


Decision = RepeatUntil | WaitFor | JumpToLine | JumpPattern | JumpLevel | JumpThreshold | IfComparison
Flow = Decision | CallSubroutine | ReturnFromCall | LoopSegment
Motor = MoveSteps | MoveAnalogue | RunOn | SearchHome
Act = (
    BlankLine
    | ForceCounter
    | InitializeState
    | MoveSteps
    | MoveAnalogue
    | RunOn
    | SearchHome
    | ArmMove
    | SetCurrent
    | SetRate
    | RateFromAnalogue
    | SetOutput
    | DelayTicks
    | DelayAnalogue
    | AssignRegister
    | SetConversion
    | PrintText
    | ReadInput
    | SetFlag
)
Statement = Flow | Act


@dataclass(frozen=True, slots=True)
class StoredLine:
    """One program line, as entered and as parsed."""

    text: str
    statement: Statement
