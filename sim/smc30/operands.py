"""Values and registers in assignments, IF, PRINT and register moves (L2844-L3004)."""

import re
from dataclasses import dataclass
from typing import Literal

from sim.smc30.refusal import Refused

WORD = 65_535
LAST_REGISTER = 510
Letter = Literal["R", "S", "T", "D", "L", "n"]


@dataclass(frozen=True, slots=True)
class Number:
    """A literal 0-65535 (L2987)."""

    value: int


@dataclass(frozen=True, slots=True)
class User:
    """User register R1-R510."""

    number: int


@dataclass(frozen=True, slots=True)
class Indirect:
    """`R(Rn)`: the user register that Rn points to (L2936-L2965)."""

    pointer: int


@dataclass(frozen=True, slots=True)
class Predefined:
    """Ramp, start rate, top rate, delay, loop counter or position counter (L2851-L2876)."""

    letter: Letter


@dataclass(frozen=True, slots=True)
class Analogue:
    """Level 0-255 of an analogue input (L2878)."""

    input: int


Operand = Number | User | Indirect | Predefined | Analogue
Target = User | Indirect | Predefined

_INDIRECT = re.compile(r"R\(R(\d+)\)")
_USER = re.compile(r"R(\d+)")
_ANALOGUE = re.compile(r"A(\d+)")
_LETTERS: dict[str, Letter] = {"R": "R", "S": "S", "T": "T", "D": "D", "L": "L", "n": "n"}


def bounded(digits: str, low: int, high: int, code: Literal["E4", "E5"] = "E4") -> int:
    """A number in range; too many digits are E2, out of range is `code` (decision 32)."""
    if len(digits) > len(str(high)):
        raise Refused("E2")
    value = int(digits)
    if not low <= value <= high:
        raise Refused(code)
    return value


def read_operand(text: str) -> Operand:
    """What `text` stands for; `Refused` if nothing."""
    if text.isascii() and text.isdigit():
        return Number(bounded(text, 0, WORD))
    if match := _ANALOGUE.fullmatch(text):
        return Analogue(bounded(match[1], 1, 6))
    return _read_register(text)


def read_target(text: str) -> Target:
    """What can be assigned to: all registers but n and the analogue inputs (L2996-L2998)."""
    target = _read_register(text)
    if target == Predefined("n"):
        raise Refused("E4")
    return target


def _read_register(text: str) -> Target:
    if text in _LETTERS:
        return Predefined(_LETTERS[text])
    if match := _INDIRECT.fullmatch(text):
        return Indirect(bounded(match[1], 1, LAST_REGISTER))
    if match := _USER.fullmatch(text):
        return User(bounded(match[1], 1, LAST_REGISTER))
    raise Refused("E4")
