"""Expressions: left to right without precedence, comparisons last, parentheses first (L15617-L15655, L15217).

An expression is compiled once from its text into a function of the `Context` that it runs in.
"""

import math
import re
from collections.abc import Callable
from functools import lru_cache

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.context import CommandContext, Evaluator

Binary = Callable[[int, int], int]

_TOKEN = re.compile(
    r"""\s*(?:(?P<string>"[^"]*")|(?P<number>\$[0-9A-F]+(?:\.[0-9A-F]*)?|\d+\.?\d*|\.\d+)"""
    r"""|(?P<name>[@_]?[A-Za-z][A-Za-z0-9]*(?:~[a-z])?|~[a-d])|(?P<op><=|>=|<>|[-+*/&|<>=()\[\]]))"""
)
_KEYWORD = re.compile(r"P[12](?:CD|CH|NM|ST)")
_DEPTH = {")": 4, "]": 8}
"""Nesting limit of parentheses (L15620) and of the brackets of functions and indices."""
_STEPS_PER_DEGREE = 128
"""Resolution of the argument of @SIN and @COS (L15656)."""

_ARITHMETIC: dict[str, Binary] = {
    "+": lambda a, b: fixed.clamp_range(a + b),
    "-": lambda a, b: fixed.clamp_range(a - b),
    "*": fixed.multiply_fixed,
    "/": fixed.divide_fixed,
    "&": lambda a, b: a & b,
    "|": lambda a, b: a | b,
}
_COMPARISON: dict[str, Binary] = {
    "<": lambda a, b: fixed.ONE if a < b else 0,
    ">": lambda a, b: fixed.ONE if a > b else 0,
    "=": lambda a, b: fixed.ONE if a == b else 0,
    "<=": lambda a, b: fixed.ONE if a <= b else 0,
    ">=": lambda a, b: fixed.ONE if a >= b else 0,
    "<>": lambda a, b: fixed.ONE if a != b else 0,
}


def _angle_function(function: Callable[[float], float]) -> Callable[[int], int]:
    return lambda raw: fixed.from_real(function(math.radians(raw / fixed.ONE)))


def _wave_function(function: Callable[[float], float]) -> Callable[[int], int]:
    step = fixed.ONE // _STEPS_PER_DEGREE
    plain = _angle_function(function)
    return lambda raw: plain((raw + step // 2) // step * step)


def _arc_function(function: Callable[[float], float]) -> Callable[[int], int]:
    def compute_arc(raw: int) -> int:
        if abs(raw) > fixed.ONE:
            raise CommandError(6)
        return fixed.from_real(math.degrees(function(raw / fixed.ONE)))

    return compute_arc


def _fraction_part(raw: int) -> int:
    return raw - fixed.to_integer(raw) * fixed.ONE


def _square_root(raw: int) -> int:
    return math.isqrt(abs(raw) << 16)


FUNCTIONS: dict[str, Callable[[int], int]] = {
    "@ABS": lambda raw: fixed.clamp_range(abs(raw)),
    "@ACOS": _arc_function(math.acos),
    "@ASIN": _arc_function(math.asin),
    "@ATAN": lambda raw: fixed.from_real(math.degrees(math.atan(raw / fixed.ONE))),
    "@COM": lambda raw: fixed.from_integer(~fixed.to_integer(raw)),
    "@COS": _wave_function(math.cos),
    "@FRAC": _fraction_part,
    "@INT": lambda raw: fixed.from_integer(fixed.to_integer(raw)),
    "@RND": lambda raw: ((raw + fixed.ONE // 2) >> 16) << 16,
    "@SIN": _wave_function(math.sin),
    "@SQR": _square_root,
    "@TAN": _angle_function(math.tan),
}


class _ExpressionParser:
    def __init__(self, text: str) -> None:
        self.tokens: list[tuple[str, str]] = []
        position = 0
        while position < len(text):
            match = _TOKEN.match(text, position)
            if match is None:
                if '"' in text[position:]:
                    raise CommandError(52)
                raise CommandError(51 if text[position] == "?" else 4)
            kind = match.lastgroup or ""
            self.tokens.append((kind, match[kind]))
            position = match.end()
        self.index = 0
        self.depth = dict.fromkeys(_DEPTH, 0)
        self.text = text

    def peek_token(self) -> str:
        return self.tokens[self.index][1] if self.index < len(self.tokens) else ""

    def parse_comparison(self) -> Evaluator:
        value = self.parse_arithmetic()
        while (operator := _COMPARISON.get(self.peek_token())) is not None:
            self.index += 1
            value = _apply_operator(operator, value, self.parse_arithmetic())
        return value

    def parse_arithmetic(self) -> Evaluator:
        value = self.parse_term()
        while (operator := _ARITHMETIC.get(self.peek_token())) is not None:
            self.index += 1
            value = _apply_operator(operator, value, self.parse_term())
        return value

    def parse_term(self) -> Evaluator:
        if self.index >= len(self.tokens):
            raise CommandError(59 if "(" in self.text and self.text.count("(") != self.text.count(")") else 4)
        kind, text = self.tokens[self.index]
        self.index += 1
        if text == "-":
            inner = self.parse_term()
            return lambda c: fixed.clamp_range(-inner(c))
        if text == "+":
            return self.parse_term()
        if text == "(":
            return self.parse_bracket(")")
        if kind == "number":
            constant = fixed.parse_literal(text)
            return lambda c: constant
        if kind == "string":
            characters = fixed.from_string(text[1:-1])
            return lambda c: characters
        if kind == "name":
            return self.parse_name(text)
        raise CommandError(4)

    def parse_bracket(self, close: str) -> Evaluator:
        self.depth[close] += 1
        if self.depth[close] > _DEPTH[close]:
            raise CommandError(59)
        value = self.parse_comparison()
        if self.peek_token() != close:
            raise CommandError(59 if close == ")" else 55)
        self.index += 1
        self.depth[close] -= 1
        return value

    def parse_name(self, text: str) -> Evaluator:
        if text.startswith("~"):
            return lambda c: fixed.from_integer(c.machine.designators.designator_number(text))
        if text.startswith("@"):
            if self.peek_token() != "[":
                raise CommandError(55 if text in FUNCTIONS or text in ("@IN", "@OUT", "@AN") else 57)
            self.index += 1
            return _apply_function(text, self.parse_bracket("]"))
        if text.startswith("_"):
            return lambda c: c.machine.compile_operand(text)(c)
        if self.peek_token() == "[":
            self.index += 1
            index = self.parse_bracket("]")
            return lambda c: c.machine.data.read_element(text, fixed.to_integer(index(c)))
        if text == "TIME":
            return lambda c: fixed.from_integer(c.machine.time_counter())
        if _KEYWORD.fullmatch(text) is not None:
            return lambda c: _read_keyword(c, text)
        return lambda c: c.machine.data.read_variable(text)


def _read_keyword(c: CommandContext, name: str) -> int:
    machine = c.machine
    return (
        machine.operator_input.read_keyword(name)
        if name in machine.model.keywords
        else machine.data.read_variable(name)
    )


def _apply_operator(operator: Binary, left: Evaluator, right: Evaluator) -> Evaluator:
    return lambda c: operator(left(c), right(c))


def _apply_function(name: str, argument: Evaluator) -> Evaluator:
    if name == "@IN":
        return lambda c: fixed.from_integer(c.machine.io.read_input(fixed.to_integer(argument(c))))
    if name == "@OUT":
        return lambda c: fixed.from_integer(c.machine.io.read_output(fixed.to_integer(argument(c))))
    if name == "@AN":
        return lambda c: c.machine.io.read_analog(fixed.to_integer(argument(c)))
    function = FUNCTIONS.get(name)
    if function is None:
        raise CommandError(57)

    def evaluate_function(c: CommandContext) -> int:
        if name not in c.machine.model.functions:
            raise CommandError(57)
        return function(argument(c))

    return evaluate_function


@lru_cache(maxsize=4096)
def compile_expression(text: str) -> Evaluator:
    """Compile `text` (blanks outside quotes already removed) to a function. Raises `CommandError`."""
    parser = _ExpressionParser(text)
    value = parser.parse_comparison()
    if parser.index != len(parser.tokens):
        raise CommandError(59 if parser.peek_token() in "()" else 55 if parser.peek_token() in "[]" else 4)
    return value


def compile_integer(text: str) -> Callable[[CommandContext], int]:
    """Compile like `compile_expression`, with the result cut to an integer (D80)."""
    value = compile_expression(text)
    return lambda c: fixed.to_integer(value(c))
