"""Values and registers in assignments, IF, PRINT and register moves (L2844-L3004)."""

import re
from dataclasses import dataclass
from typing import Literal

from sim.smc30.refusal import StatementRefused

WORD = 65_535
LAST_REGISTER = 510
Letter = Literal["R", "S", "T", "D", "L", "n"]


@dataclass(frozen=True, slots=True)
class NumberLiteral:
    """A literal 0-65535 (L2987)."""

    value: int


@dataclass(frozen=True, slots=True)
class UserRegister:
    """User register R1-R510."""

    number: int


@dataclass(frozen=True, slots=True)
class IndirectRegister:
    """`R(Rn)`: the user register that Rn points to (L2936-L2965)."""

    pointer: int


@dataclass(frozen=True, slots=True)
class PredefinedRegister:
    """Ramp, start rate, top rate, delay, loop counter or position counter (L2851-L2876)."""

    letter: Letter


@dataclass(frozen=True, slots=True)
class AnalogueLevel:
    """Level 0-255 of an analogue input (L2878)."""

    input: int


Operand = NumberLiteral | UserRegister | IndirectRegister | PredefinedRegister | AnalogueLevel
Target = UserRegister | IndirectRegister | PredefinedRegister

_INDIRECT = re.compile(r"R\(R(\d+)\)")
_USER = re.compile(r"R(\d+)")
_ANALOGUE = re.compile(r"A(\d+)")
_LETTERS: dict[str, Letter] = {"R": "R", "S": "S", "T": "T", "D": "D", "L": "L", "n": "n"}


def parse_bounded(digits: str, low: int, high: int, code: Literal["E4", "E5"] = "E4") -> int:
    """Parse a number in range; too many digits are E2, out of range is `code` (decision 32)."""
    if len(digits) > len(str(high)):
        raise StatementRefused("E2")
    value = int(digits)
    if not low <= value <= high:
        raise StatementRefused(code)
    return value


def read_operand(text: str) -> Operand:
    """Parse an operand; `StatementRefused` if `text` is none."""
    if text.isascii() and text.isdigit():
        return NumberLiteral(parse_bounded(text, 0, WORD))
    if match := _ANALOGUE.fullmatch(text):
        return AnalogueLevel(parse_bounded(match[1], 1, 6))
    return _read_register(text)


def read_target(text: str) -> Target:
    """Parse an assignment target: all registers but n and the analogue inputs (L2996-L2998)."""
    target = _read_register(text)
    if target == PredefinedRegister("n"):
        raise StatementRefused("E4")
    return target


def _read_register(text: str) -> Target:
    if text in _LETTERS:
        return PredefinedRegister(_LETTERS[text])
    if match := _INDIRECT.fullmatch(text):
        return IndirectRegister(parse_bounded(match[1], 1, LAST_REGISTER))
    if match := _USER.fullmatch(text):
        return UserRegister(parse_bounded(match[1], 1, LAST_REGISTER))
    raise StatementRefused("E4")
