"""From a command's text to a statement that a program can hold."""

import re
from collections.abc import Callable
from typing import cast

from sim.smc30.operands import WORD, Operand, Predefined, User, bounded, read_operand, read_target
from sim.smc30.parameters import RANGES, Rate
from sim.smc30.refusal import Refused
from sim.smc30.statements import (
    Arm,
    Assign,
    Blank,
    Call,
    Comparison,
    Contact,
    Convert,
    Delay,
    DelayAnalogue,
    Falling,
    Flag,
    Force,
    Home,
    If,
    Initialize,
    Input,
    Jump,
    JumpLevel,
    JumpPattern,
    JumpThreshold,
    Level,
    Loop,
    Move,
    MoveAnalogue,
    Operator,
    Output,
    Print,
    RateFromAnalogue,
    Return,
    RunOn,
    Scaled,
    SetCurrent,
    SetRate,
    Statement,
    Threshold,
    Until,
    WaitFor,
)

_LAST_STEP = 8_388_607
_LAST_LINE = 255
_LAST_DELAY = 32_000
_CURRENT_DIGITS = 12_000
_PC = 255
_LOGIC_LEVELS = 2

Builder = Callable[[re.Match[str]], Statement]


def _sign(text: str) -> int:
    return -1 if text == "-" else 1


def _analogue(digits: str) -> int:
    return bounded(digits, 1, 6)


def _contact(letter: str, digits: str) -> Contact:
    return Contact(bounded(digits, 1, 6 if letter else 3), bool(letter))


def _line(digits: str) -> int:
    return bounded(digits, 0, _LAST_LINE)


def _no_argument(text: str) -> None:
    if text:
        raise Refused("E2")


def _force(match: re.Match[str]) -> Statement:
    return Force(_sign(match[1]) * bounded(match[2], 0, _LAST_STEP))


def _initialize(match: re.Match[str]) -> Statement:
    what = bounded(match[1], 1, 7)
    if what == 4:
        raise Refused("E4")
    return Initialize(what)


def _move(match: re.Match[str]) -> Statement:
    absolute = bool(match[1])
    return Move(_sign(match[2]), absolute, bounded(match[3], 0 if absolute else 1, _LAST_STEP))


def _move_register(match: re.Match[str]) -> Statement:
    return Move(_sign(match[2]), bool(match[1]), User(bounded(match[3], 1, 510)))


def _move_analogue(match: re.Match[str]) -> Statement:
    absolute = bool(match[1])
    low = 0 if absolute else 1
    scaled = Scaled(_analogue(match[3]), bounded(match[4], low, 65_000), bounded(match[5], low, 65_000))
    return MoveAnalogue(_sign(match[2]), absolute, scaled)


def _run_on(match: re.Match[str]) -> Statement:
    _no_argument(match[2])
    return RunOn(_sign(match[1]))


def _home(match: re.Match[str]) -> Statement:
    _no_argument(match[2])
    return Home(_sign(match[1]))


def _arm(match: re.Match[str]) -> Statement:
    _no_argument(match[5])
    start, stop = bounded(match[1], 1, 3), bounded(match[2], 1, 3)
    start_level, stop_level = int(match[3]), int(match[4])
    begin = Level(start, bool(start_level)) if start_level < _LOGIC_LEVELS else None
    end = {0: Falling(stop), 1: Level(stop, True)}.get(stop_level)
    return Arm(3, begin, end)


def _threshold(input_: str, comparison: str, reference: str) -> Threshold:
    return Threshold(_analogue(input_), comparison == ">", bounded(reference, 0, 255))


def _arm_analogue(match: re.Match[str]) -> Statement:
    start = _threshold(match[2], match[3], match[4]) if match[1] != "X" else None
    stop = _threshold(match[6], match[7], match[8]) if match[5] != "X" else None
    return Arm(7, start, stop)


def _current(match: re.Match[str]) -> Statement:
    return SetCurrent(match[1], bounded(match[2], 0, _CURRENT_DIGITS))


def _rate(match: re.Match[str]) -> Statement:
    rate = cast(Rate, match[1])
    return SetRate(rate, bounded(match[2], *RANGES[rate], "E5"))


def _rate_from_analogue(match: re.Match[str]) -> Statement:
    input_, scale = _analogue(match[2]), bounded(match[3], 1, 10)
    letter = match[1]
    return RateFromAnalogue("R" if letter == "r" else "S" if letter == "s" else "T", input_, scale)


def _output(match: re.Match[str]) -> Statement:
    return Output(bounded(match[2], 1, 3), match[1] == "A")


def _until(match: re.Match[str]) -> Statement:
    return Until(_contact(match[1], match[2]))


def _wait_for(match: re.Match[str]) -> Statement:
    return WaitFor(_contact(match[1], match[2]))


def _delay(match: re.Match[str]) -> Statement:
    return Delay(bounded(match[1], 1, _LAST_DELAY))


def _delay_analogue(match: re.Match[str]) -> Statement:
    low, high = bounded(match[2], 1, _LAST_DELAY), bounded(match[3], 1, _LAST_DELAY)
    return DelayAnalogue(Scaled(_analogue(match[1]), low, high))


def _jump(match: re.Match[str]) -> Statement:
    return Jump(_line(match[1]))


def _jump_pattern(match: re.Match[str]) -> Statement:
    return JumpPattern(bounded(match[1], 0, 7), _line(match[2]))


def _jump_level(match: re.Match[str]) -> Statement:
    return JumpLevel(_contact(match[1], match[2]), bool(bounded(match[3], 0, 1)), _line(match[4]))


def _jump_threshold(match: re.Match[str]) -> Statement:
    return JumpThreshold(_threshold(match[1], match[2], match[3]), _line(match[4]))


def _call(match: re.Match[str]) -> Statement:
    return Call(_line(match[1]))


def _return(match: re.Match[str]) -> Statement:
    _no_argument(match[1])
    return Return()


def _loop(match: re.Match[str]) -> Statement:
    return Loop(bounded(match[1], 0, 255))


def _convert(match: re.Match[str]) -> Statement:
    if len(match[1]) > 4 or len(match[2] or "") > 4:
        raise Refused("E2")
    factor = int(match[1]) * 10_000 + int((match[2] or "").ljust(4, "0"))
    if not 1 <= factor <= 16_000_000:
        raise Refused("E4")
    return Convert(factor)


def _print(match: re.Match[str]) -> Statement:
    module = bounded(match[1], 1, _PC)
    if 31 < module < _PC:
        raise Refused("E4")
    what: Operand | str = match[4] if match[4] is not None else read_operand(match[3])
    return Print(module, bounded(match[2], 0, 255), what)


def _if(match: re.Match[str]) -> Statement:
    return If(read_operand(match[1]), cast(Comparison, match[2]), read_operand(match[3]))


def _input(match: re.Match[str]) -> Statement:
    allowed = None
    if match[4] is not None:
        low, high = (match[4], match[5]) if match[5] is not None else ("0", match[4])
        allowed = (bounded(low, 0, WORD), bounded(high, 0, WORD))
    return Input(read_target(match[1]), bounded(match[2], 0, 31), bounded(match[3], 0, 255), allowed)


def _assign(match: re.Match[str]) -> Statement:
    target, left = read_target(match[1]), match[2]
    if match[3] is not None:
        return Assign(target, read_operand(left), cast(Operator, match[3]), read_operand(match[4]))
    if isinstance(target, Predefined) and left.isdigit() and target.letter in ("R", "S", "T"):
        # T=2000 is T2000 (L3000), so its bounds hold as well.
        bounded(left, *RANGES[target.letter], "E5")
    return Assign(target, read_operand(left))


def _flag(match: re.Match[str]) -> Statement:
    return Flag(bounded(match[2], 1, 31), bounded(match[3], 1, 255), match[1] == "A")


_THRESHOLD = r"(X|A(\d+)([<>])(\d+))"
_FORMS: list[tuple[re.Pattern[str], Builder]] = [
    (re.compile(form), builder)
    for form, builder in (
        (r"f([+-])(\d+)", _force),
        (r"I(\d+)", _initialize),
        (r"(G?)([+-])(\d+)", _move),
        (r"(G?)([+-])\(R(\d+)\)", _move_register),
        (r"(G?)([+-])A(\d+)\.(\d+)-(\d+)", _move_analogue),
        (r"g([+-])(\d*)", _run_on),
        (r"H([+-])(\d*)", _home),
        (r"N(\d)(\d)\.(\d)(\d)(\d*)", _arm),
        (rf"NA{_THRESHOLD}\.{_THRESHOLD}", _arm_analogue),
        (r"(C[SRT])(\d+)", _current),
        (r"(RT|RS|R|S|T)(\d+)", _rate),
        (r"([rst])(\d+)\.(\d+)", _rate_from_analogue),
        (r"([AC])(\d+)", _output),
        (r"U(A?)(\d+)", _until),
        (r"W(A?)(\d+)", _wait_for),
        (r"D(\d+)", _delay),
        (r"DA(\d+)\.(\d+)-(\d+)", _delay_analogue),
        (r"J(\d+)", _jump),
        (r"JC(\d+)\.(\d+)", _jump_pattern),
        (r"JC(A?)(\d+)=(\d+)\.(\d+)", _jump_level),
        (r"JCA(\d+)([<>])(\d+)\.(\d+)", _jump_threshold),
        (r"JS(\d+)", _call),
        (r"RET(\d*)", _return),
        (r"L(\d+)", _loop),
        (r"con=(\d+)(?:\.(\d+))?", _convert),
        (r'PRINT(\d+)\.(\d+)\.(?:([^"]+)|"([^"]*)")', _print),
        (r"IF([^<>=]+)(<=|>=|<>|<|>|=)([^<>=]+)", _if),
        (r"([^=]+)=INPUT(\d+)\.(\d+)(?:\.(\d+)(?:-(\d+))?)?", _input),
        (r"(R|S|T|D|L|R\d+|R\(R\d+\))=([^=+*/-]+)(?:([+*/-])([^=+*/-]+))?", _assign),
        (r"([AC])O(\d+)\.(\d+)", _flag),
    )
]


def compact(text: str) -> str:
    """`text` without blanks outside quotes (decision 5)."""
    if " " not in text:
        return text
    parts = text.split('"')
    parts[::2] = [part.replace(" ", "") for part in parts[::2]]
    return '"'.join(parts)


def read_statement(text: str) -> Statement:
    """The statement that compact `text` is. `Refused` for what no program line can be."""
    if not text:
        return Blank()
    for form, builder in _FORMS:
        if match := form.fullmatch(text):
            return builder(match)
    raise Refused("E4")
