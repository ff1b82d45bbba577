"""Expressions: left to right without precedence, comparisons last, parentheses first (L15617-L15655, L15217).

An expression is compiled once from its text into a function of the `Context` that it runs in.
"""

import math
import re
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError

if TYPE_CHECKING:
    from sim.yaskawa.language.context import Context

Evaluator = Callable[["Context"], int]
Binary = Callable[[int, int], int]

_TOKEN = re.compile(
    r"""\s*(?:(?P<string>"[^"]*")|(?P<number>\$[0-9A-F]+(?:\.[0-9A-F]*)?|\d+\.?\d*|\.\d+)"""
    r"""|(?P<name>[@_]?[A-Za-z][A-Za-z0-9]*(?:~[a-z])?|~[a-d])|(?P<op><=|>=|<>|[-+*/&|<>=()\[\]]))"""
)
_KEYWORD = re.compile(r"P[12](?:CD|CH|NM|ST)")
_DEPTH = {")": 4, "]": 8}
"""How deep parentheses (L15620) and the brackets of functions and indices may be nested."""
_STEPS_PER_DEGREE = 128
"""Of the argument of @SIN and @COS (L15656)."""

_ARITHMETIC: dict[str, Binary] = {
    "+": lambda a, b: fixed.clamp(a + b),
    "-": lambda a, b: fixed.clamp(a - b),
    "*": fixed.multiply,
    "/": fixed.divide,
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


def _angle(function: Callable[[float], float]) -> Callable[[int], int]:
    return lambda raw: fixed.of(function(math.radians(raw / fixed.ONE)))


def _wave(function: Callable[[float], float]) -> Callable[[int], int]:
    step = fixed.ONE // _STEPS_PER_DEGREE
    plain = _angle(function)
    return lambda raw: plain((raw + step // 2) // step * step)


def _arc(function: Callable[[float], float]) -> Callable[[int], int]:
    def run(raw: int) -> int:
        if abs(raw) > fixed.ONE:
            raise CommandError(6)
        return fixed.of(math.degrees(function(raw / fixed.ONE)))

    return run


def _fraction(raw: int) -> int:
    return raw - fixed.truncated(raw) * fixed.ONE


def _square_root(raw: int) -> int:
    return math.isqrt(abs(raw) << 16)


FUNCTIONS: dict[str, Callable[[int], int]] = {
    "@ABS": lambda raw: fixed.clamp(abs(raw)),
    "@ACOS": _arc(math.acos),
    "@ASIN": _arc(math.asin),
    "@ATAN": lambda raw: fixed.of(math.degrees(math.atan(raw / fixed.ONE))),
    "@COM": lambda raw: fixed.whole(~fixed.truncated(raw)),
    "@COS": _wave(math.cos),
    "@FRAC": _fraction,
    "@INT": lambda raw: fixed.whole(fixed.truncated(raw)),
    "@RND": lambda raw: ((raw + fixed.ONE // 2) >> 16) << 16,
    "@SIN": _wave(math.sin),
    "@SQR": _square_root,
    "@TAN": _angle(math.tan),
}


class _Parser:
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

    def peek(self) -> str:
        return self.tokens[self.index][1] if self.index < len(self.tokens) else ""

    def comparison(self) -> Evaluator:
        value = self.arithmetic()
        while (operator := _COMPARISON.get(self.peek())) is not None:
            self.index += 1
            value = _apply(operator, value, self.arithmetic())
        return value

    def arithmetic(self) -> Evaluator:
        value = self.term()
        while (operator := _ARITHMETIC.get(self.peek())) is not None:
            self.index += 1
            value = _apply(operator, value, self.term())
        return value

    def term(self) -> Evaluator:
        if self.index >= len(self.tokens):
            raise CommandError(59 if "(" in self.text and self.text.count("(") != self.text.count(")") else 4)
        kind, text = self.tokens[self.index]
        self.index += 1
        if text == "-":
            inner = self.term()
            return lambda c: fixed.clamp(-inner(c))
        if text == "+":
            return self.term()
        if text == "(":
            return self.bracket(")")
        if kind == "number":
            constant = fixed.literal(text)
            return lambda c: constant
        if kind == "string":
            characters = fixed.of_string(text[1:-1])
            return lambda c: characters
        if kind == "name":
            return self.name(text)
        raise CommandError(4)

    def bracket(self, close: str) -> Evaluator:
        self.depth[close] += 1
        if self.depth[close] > _DEPTH[close]:
            raise CommandError(59)
        value = self.comparison()
        if self.peek() != close:
            raise CommandError(59 if close == ")" else 55)
        self.index += 1
        self.depth[close] -= 1
        return value

    def name(self, text: str) -> Evaluator:
        if text.startswith("~"):
            return lambda c: fixed.whole(c.machine.designated(text))
        if text.startswith("@"):
            if self.peek() != "[":
                raise CommandError(55 if text in FUNCTIONS or text in ("@IN", "@OUT", "@AN") else 57)
            self.index += 1
            return _function(text, self.bracket("]"))
        if text.startswith("_"):
            return lambda c: c.machine.model.operand(text)(c)
        if self.peek() == "[":
            self.index += 1
            index = self.bracket("]")
            return lambda c: c.machine.data.element(text, fixed.truncated(index(c)))
        if text == "TIME":
            return lambda c: fixed.whole(c.machine.time_counter())
        if _KEYWORD.fullmatch(text) is not None:
            return lambda c: _keyword(c, text)
        return lambda c: c.machine.data.variable(text)


def _keyword(c: "Context", name: str) -> int:
    machine = c.machine
    return machine.keyword(name) if name in machine.model.keywords else machine.data.variable(name)


def _apply(operator: Binary, left: Evaluator, right: Evaluator) -> Evaluator:
    return lambda c: operator(left(c), right(c))


def _function(name: str, argument: Evaluator) -> Evaluator:
    if name == "@IN":
        return lambda c: fixed.whole(c.machine.io.read_input(fixed.truncated(argument(c))))
    if name == "@OUT":
        return lambda c: fixed.whole(c.machine.io.read_output(fixed.truncated(argument(c))))
    if name == "@AN":
        return lambda c: c.machine.io.read_analog(fixed.truncated(argument(c)))
    function = FUNCTIONS.get(name)
    if function is None:
        raise CommandError(57)

    def run(c: "Context") -> int:
        if name not in c.machine.model.functions:
            raise CommandError(57)
        return function(argument(c))

    return run


@lru_cache(maxsize=4096)
def compile_expression(text: str) -> Evaluator:
    """The function that computes `text` (blanks outside quotes already removed). Raises `CommandError`."""
    parser = _Parser(text)
    value = parser.comparison()
    if parser.index != len(parser.tokens):
        raise CommandError(59 if parser.peek() in "()" else 55 if parser.peek() in "[]" else 4)
    return value


def integer(text: str) -> Callable[["Context"], int]:
    """Like `compile_expression`, cut to an integer (D80)."""
    value = compile_expression(text)
    return lambda c: fixed.truncated(value(c))
