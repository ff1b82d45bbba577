"""Parameters and expressions: `#1`, `#<name>`, `[#1 + 2 * SIN[30]]`, with LinuxCNC's precedence and functions.

Angles are in degrees. A named parameter is of its subroutine, one whose name begins with _ of the whole program.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from orchestrator.model.paths.files.gcode.errors import LineError

DEEPEST = 50  # brackets in each second
LAST_PARAMETER = 5602
FIRST_SYSTEM = 5000  # from here on they are of the machine
PASSED = 30  # parameters of a subroutine's own
EQUAL = 1e-4  # numbers that differ by less are EQ, as in LinuxCNC
MOST_NAMES = 10_000

_NUMBER = re.compile(r"\d+\.?\d*|\.\d+", re.ASCII)
_NAME = re.compile(r"<([^<>]{1,100})>")
_OPERATOR = re.compile(r"\*\*|[-+*/]|MOD|EQ|NE|GT|GE|LT|LE|AND|OR|XOR", re.IGNORECASE)
_FUNCTION = re.compile(r"ABS|ACOS|ASIN|ATAN|COS|EXISTS|EXP|FIX|FUP|LN|ROUND|SIN|SQRT|TAN", re.IGNORECASE)


@dataclass(slots=True)
class Scope:
    """Parameters of one subroutine: those that it was passed, and its named ones."""

    passed: dict[int, float] = field(default_factory=dict[int, float])
    named: dict[str, float] = field(default_factory=dict[str, float])


@dataclass(slots=True)
class Calculator:
    """All parameters of a program. state: what the program may read of the machine, by name or number."""

    state: Callable[[int | str], float | None] = lambda _: None
    scopes: list[Scope] = field(default_factory=lambda: [Scope()])
    numbered: dict[int, float] = field(default_factory=dict[int, float])
    common: dict[str, float] = field(default_factory=dict[str, float])

    def find_parameter(self, name: int | str) -> float | None:
        """The value of a parameter; None: it has none."""
        if isinstance(name, str):
            names = self.common if name.startswith("_") else self.scopes[-1].named
            return names[name] if name in names else self.state(name)
        if name <= PASSED:
            return self.scopes[-1].passed.get(name, 0.0)
        return self.numbered.get(name, 0.0) if name <= FIRST_SYSTEM else self.state(name)

    def set_parameter(self, name: int | str, value: float) -> None:
        """Set a parameter that may be set."""
        if isinstance(name, str):
            names = self.common if name.startswith("_") else self.scopes[-1].named
            if len(names) >= MOST_NAMES and name not in names:
                raise LineError(0, f"the program has more than {MOST_NAMES} named parameters")
            names[name] = value
        elif name <= PASSED:
            self.scopes[-1].passed[name] = value
        else:
            self.numbered[name] = value


def _divide(a: float, b: float) -> float:
    if b == 0:
        raise ValueError("a division by 0")
    return a / b


def _find_remainder(a: float, b: float) -> float:
    if b == 0:
        raise ValueError("a division by 0")
    remainder = math.fmod(a, b)
    return remainder + abs(b) if remainder < 0 else remainder


def _raise_power(a: float, b: float) -> float:
    if a < 0 and b != int(b):
        raise ValueError(f"{a:g} to the power of {b:g} does not exist")
    return math.pow(a, b)


_RANKS: Mapping[str, int] = {
    "**": 4,
    **dict.fromkeys(("*", "/", "MOD"), 3),
    **dict.fromkeys(("+", "-"), 2),
    **dict.fromkeys(("EQ", "NE", "GT", "GE", "LT", "LE"), 1),
    **dict.fromkeys(("AND", "OR", "XOR"), 0),
}
_OPERATIONS: Mapping[str, Callable[[float, float], float]] = {
    "**": _raise_power,
    "*": lambda a, b: a * b,
    "/": _divide,
    "MOD": _find_remainder,
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "EQ": lambda a, b: float(abs(a - b) < EQUAL),
    "NE": lambda a, b: float(abs(a - b) >= EQUAL),
    "GT": lambda a, b: float(a > b),
    "GE": lambda a, b: float(a >= b),
    "LT": lambda a, b: float(a < b),
    "LE": lambda a, b: float(a <= b),
    "AND": lambda a, b: float(a != 0 and b != 0),
    "OR": lambda a, b: float(a != 0 or b != 0),
    "XOR": lambda a, b: float((a != 0) != (b != 0)),
}
_FUNCTIONS: Mapping[str, Callable[[float], float]] = {
    "ABS": abs,
    "ACOS": lambda a: math.degrees(math.acos(a)),
    "ASIN": lambda a: math.degrees(math.asin(a)),
    "COS": lambda a: math.cos(math.radians(a)),
    "EXP": math.exp,
    "FIX": lambda a: float(math.floor(a)),
    "FUP": lambda a: float(math.ceil(a)),
    "LN": math.log,
    "ROUND": lambda a: math.copysign(math.floor(abs(a) + 0.5), a),
    "SIN": lambda a: math.sin(math.radians(a)),
    "SQRT": math.sqrt,
    "TAN": lambda a: math.tan(math.radians(a)),
}


class ExpressionReader:
    """Reads numbers, parameters and expressions of one line. at: the place of what is read next."""

    def __init__(self, text: str, calculator: Calculator, at: int = 0) -> None:
        self.text = text
        self.at = at
        self._calculator = calculator
        self._depth = 0

    @property
    def is_at_end(self) -> bool:
        """Whether only spaces are left."""
        while self.at < len(self.text) and self.text[self.at].isspace():
            self.at += 1
        return self.at >= len(self.text)

    def peek(self) -> str:
        """The next sign; empty at the end."""
        return "" if self.is_at_end else self.text[self.at]

    def read_value(self) -> tuple[float, bool]:
        """A number, a parameter, an expression or a function, and whether it has a decimal point. Raises
        `LineError`."""
        sign = 1.0
        if self.peek() in ("-", "+") and self.peek():
            sign = -1.0 if self.text[self.at] == "-" else 1.0
            self.at += 1
        begin, first = self.at, self.peek()
        if first == "[":
            return sign * self.read_bracket(), True
        if first == "#":
            self.at += 1
            return sign * self._read_parameter(), True
        if (match := _NUMBER.match(self.text, self.at)) is not None:
            self.at = match.end()
            return sign * float(match.group()), "." in match.group()
        if (match := _FUNCTION.match(self.text, self.at)) is not None:
            self.at = match.end()
            return sign * self._read_function(match.group().upper(), begin), True
        raise self._make_error()

    def read_bracket(self) -> float:
        """An expression in brackets. Raises `LineError`."""
        if self.peek() != "[":
            raise self._make_error("an expression in brackets, [ ]")
        if self._depth >= DEEPEST:
            raise LineError(self.at + 1, f"brackets are nested more than {DEEPEST} deep")
        begin = self.at
        self.at += 1
        self._depth += 1
        value = self._read_operations(0, begin)
        self._depth -= 1
        if self.peek() != "]":
            raise self._make_error("an operator or ]")
        self.at += 1
        return value

    def read_setting(self) -> tuple[int | str, float]:
        """The name and the value of `#name = value`, behind the #. Raises `LineError`."""
        begin = self.at
        name = self._read_name()
        if self.peek() != "=":
            raise self._make_error("=")
        self.at += 1
        value, _ = self.read_value()
        if isinstance(name, int) and name > FIRST_SYSTEM:
            raise LineError(begin, f"parameter {name} is the machine's, and is not set by a program")
        return name, value

    def _read_operations(self, rank: int, begin: int) -> float:
        """Operations of a rank and those above, from the left."""
        value = self.read_value()[0] if rank > 4 else self._read_operations(rank + 1, begin)
        while rank <= 4 and (match := self._match_operator(rank)) is not None:
            at, name = self.at, match.group().upper()
            self.at = match.end()
            second = self.read_value()[0] if rank == 4 else self._read_operations(rank + 1, begin)
            value = self._compute(lambda a=value, b=second, name=name: _OPERATIONS[name](a, b), at)
        return value

    def _match_operator(self, rank: int) -> re.Match[str] | None:
        if self.is_at_end:
            return None
        match = _OPERATOR.match(self.text, self.at)
        return match if match is not None and _RANKS[match.group().upper()] == rank else None

    def _read_function(self, name: str, begin: int) -> float:
        if name == "EXISTS":
            return self._read_exists()
        value = self.read_bracket()
        if name != "ATAN":
            return self._compute(lambda: _FUNCTIONS[name](value), begin)
        if self.peek() != "/":
            raise self._make_error("/, as in ATAN[1]/[2]")
        self.at += 1
        second = self.read_bracket()
        return self._compute(lambda: math.degrees(math.atan2(value, second)), begin)

    def _read_exists(self) -> float:
        """EXISTS[#<name>]: 1 if the parameter has a value."""
        for sign in "[#":
            if self.peek() != sign:
                raise self._make_error("the name of a parameter, as in EXISTS[#<name>]")
            self.at += 1
        is_known = self._calculator.find_parameter(self._read_name()) is not None
        if self.peek() != "]":
            raise self._make_error("]")
        self.at += 1
        return float(is_known)

    def _read_name(self) -> int | str:
        """The number or the name of a parameter, behind its #."""
        begin = self.at
        if self.peek() == "<":
            match = _NAME.match(self.text, self.at)
            if match is None:
                raise self._make_error("a name, as in #<name>")
            self.at = match.end()
            return re.sub(r"\s", "", match[1]).lower()
        self._depth += 1
        if self._depth > DEEPEST:
            raise LineError(begin + 1, f"parameters are nested more than {DEEPEST} deep")
        value, _ = self.read_value()
        self._depth -= 1
        number = round(value)
        if abs(value - number) > EQUAL or not 1 <= number <= LAST_PARAMETER:
            raise LineError(begin + 1, f"a parameter has a number from 1 to {LAST_PARAMETER}, not {value:g}")
        return number

    def _read_parameter(self) -> float:
        begin = self.at
        name = self._read_name()
        value = self._calculator.find_parameter(name)
        if value is None:
            shown_name = f"#<{name}>" if isinstance(name, str) else f"#{name}"
            raise LineError(begin, f"parameter {shown_name} has no value here")
        return value

    def _compute(self, operation: Callable[[], float], at: int) -> float:
        try:
            value = operation()
        except OverflowError:
            raise LineError(at + 1, "the expression cannot be computed: it is too large") from None
        except ValueError as error:
            text = str(error) if "does not exist" in str(error) or "division" in str(error) else "it has no value"
            raise LineError(at + 1, f"the expression cannot be computed: {text}") from None
        if not math.isfinite(value):
            raise LineError(at + 1, "the expression cannot be computed: it is too large")
        return value

    def _make_error(self, expected: str = "a number") -> LineError:
        shown_text = self.text[self.at : self.at + 20].rstrip()
        if self.is_at_end:
            return LineError(max(1, len(self.text.rstrip())), f"the line ends where {expected} is expected")
        return LineError(self.at + 1, f"{shown_text!r} stands where {expected} is expected")
