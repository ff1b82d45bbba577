"""The commands that a program can hold, and the bytes each takes in working memory (L3642-L3703)."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from sim.smc30.operands import Operand, Target
from sim.smc30.parameters import Rate

Comparison = Literal["<", ">", "=", "<=", ">=", "<>"]
Operator = Literal["+", "-", "*", "/"]


@dataclass(frozen=True, slots=True)
class Contact:
    """A digital input: user input 1-3, or analogue input 1-6 with threshold 2.5 V (L2731)."""

    number: int
    analogue: bool = False


@dataclass(frozen=True, slots=True)
class Threshold:
    """Analogue input at or above (`>`), or below, a reference 0-255 (L2225-L2246, L2751-L2753)."""

    input: int
    above: bool
    reference: int


@dataclass(frozen=True, slots=True)
class Level:
    """User input at a level."""

    input: int
    level: bool


@dataclass(frozen=True, slots=True)
class Falling:
    """User input going from logic 1 to logic 0 (L2114)."""

    input: int


StartCondition = Level | Threshold
StopCondition = Level | Falling | Threshold


@dataclass(frozen=True, slots=True)
class Scaled:
    """n1 at 0 V, n2 at 5.10 V of an analogue input, linear between."""

    input: int
    at_zero: int
    at_full: int


@dataclass(frozen=True, slots=True)
class Blank:
    size: ClassVar[int] = 1


@dataclass(frozen=True, slots=True)
class Force:
    """f: set the position counter, steps."""

    size: ClassVar[int] = 4
    position: int


@dataclass(frozen=True, slots=True)
class Initialize:
    """I1-I3: counter, outputs; I5-I7: registers."""

    size: ClassVar[int] = 2
    what: int


@dataclass(frozen=True, slots=True)
class Move:
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
    amount: Scaled


@dataclass(frozen=True, slots=True)
class RunOn:
    """g: continuous run."""

    size: ClassVar[int] = 1
    sign: int


@dataclass(frozen=True, slots=True)
class Home:
    size: ClassVar[int] = 1
    sign: int


@dataclass(frozen=True, slots=True)
class Arm:
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
class Output:
    """A, C."""

    size: ClassVar[int] = 2
    number: int
    on: bool


@dataclass(frozen=True, slots=True)
class Until:
    """U: go back until the input is logic 0."""

    size: ClassVar[int] = 2
    contact: Contact


@dataclass(frozen=True, slots=True)
class WaitFor:
    """W: wait until the input is logic 1."""

    size: ClassVar[int] = 2
    contact: Contact


@dataclass(frozen=True, slots=True)
class Delay:
    """D: 1/100 s."""

    size: ClassVar[int] = 3
    ticks: int


@dataclass(frozen=True, slots=True)
class DelayAnalogue:
    size: ClassVar[int] = 6
    ticks: Scaled


@dataclass(frozen=True, slots=True)
class Jump:
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
    contact: Contact
    level: bool
    line: int


@dataclass(frozen=True, slots=True)
class JumpThreshold:
    size: ClassVar[int] = 4
    threshold: Threshold
    line: int


@dataclass(frozen=True, slots=True)
class Call:
    """JS."""

    size: ClassVar[int] = 2
    line: int


@dataclass(frozen=True, slots=True)
class Return:
    size: ClassVar[int] = 1


@dataclass(frozen=True, slots=True)
class Loop:
    """L0 begins a segment, Ln ends it and repeats it n times."""

    size: ClassVar[int] = 2
    count: int


@dataclass(frozen=True, slots=True)
class Assign:
    target: Target
    left: Operand
    operator: Operator | None = None
    right: Operand | None = None

    @property
    def size(self) -> int:
        return 12 if self.right is None else 14


@dataclass(frozen=True, slots=True)
class Convert:
    """con: steps per unit, in ten-thousandths."""

    size: ClassVar[int] = 5
    factor: int


@dataclass(frozen=True, slots=True)
class Print:
    size: ClassVar[int] = 10
    module: int
    place: int
    what: Operand | str


@dataclass(frozen=True, slots=True)
class If:
    size: ClassVar[int] = 17
    left: Operand
    comparison: Comparison
    right: Operand


@dataclass(frozen=True, slots=True)
class Input:
    """INPUT: read a module's register; `allowed` is the range check."""

    size: ClassVar[int] = 12
    target: Target
    module: int
    register: int
    allowed: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class Flag:
    """AO, CO."""

    size: ClassVar[int] = 3
    module: int
    flag: int
    on: bool


Flow = Until | WaitFor | Jump | JumpPattern | JumpLevel | JumpThreshold | Call | Return | Loop | If
Motor = Move | MoveAnalogue | RunOn | Home
Act = (
    Blank | Force | Initialize | Move | MoveAnalogue | RunOn | Home | Arm | SetCurrent | SetRate | RateFromAnalogue
    | Output | Delay | DelayAnalogue | Assign | Convert | Print | Input | Flag
)  # fmt: skip
Statement = Flow | Act


@dataclass(frozen=True, slots=True)
class Line:
    """One program line, as entered and as understood."""

    text: str
    statement: Statement
