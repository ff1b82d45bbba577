"""Parser from a command's text to a statement that a program can contain."""

import re
from collections.abc import Callable
from typing import cast

from sim.smc30.operands import WORD, Operand, PredefinedRegister, UserRegister, parse_bounded, read_operand, read_target
from sim.smc30.parameters import RANGES, Rate
from sim.smc30.refusal import StatementRefused
from sim.smc30.statements import (
    AnalogueThreshold,
    ArmMove,
    AssignRegister,
    BlankLine,
    CallSubroutine,
    Comparison,
    DelayAnalogue,
    DelayTicks,
    FallingInput,
    ForceCounter,
    IfComparison,
    InitializeState,
    InputContact,
    InputLevel,
    JumpLevel,
    JumpPattern,
    JumpThreshold,
    JumpToLine,
    LoopSegment,
    MoveAnalogue,
    MoveSteps,
    Operator,
    PrintText,
    RateFromAnalogue,
    ReadInput,
    RepeatUntil,
    ReturnFromCall,
    RunOn,
    ScaledInput,
    SearchHome,
    SetConversion,
    SetCurrent,
    SetFlag,
    SetOutput,
    SetRate,
    Statement,
    WaitFor,
)

_LAST_STEP = 8_388_607
_LAST_LINE = 255
_LAST_DELAY = 32_000
_CURRENT_DIGITS = 12_000
_PC = 255
_LOGIC_LEVELS = 2

Builder = Callable[[re.Match[str]], Statement]


def _parse_sign(text: str) -> int:
    return -1 if text == "-" else 1


def _parse_analogue_number(digits: str) -> int:
    return parse_bounded(digits, 1, 6)


def _parse_contact(letter: str, digits: str) -> InputContact:
    return InputContact(parse_bounded(digits, 1, 6 if letter else 3), bool(letter))


def _parse_line_number(digits: str) -> int:
    return parse_bounded(digits, 0, _LAST_LINE)


def _require_no_argument(text: str) -> None:
    if text:
        raise StatementRefused("E2")


def _build_force(match: re.Match[str]) -> Statement:
    return ForceCounter(_parse_sign(match[1]) * parse_bounded(match[2], 0, _LAST_STEP))


def _build_initialize(match: re.Match[str]) -> Statement:
    scope = parse_bounded(match[1], 1, 7)
    if scope == 4:
        raise StatementRefused("E4")
    return InitializeState(scope)


def _build_move(match: re.Match[str]) -> Statement:
    absolute = bool(match[1])
    return MoveSteps(_parse_sign(match[2]), absolute, parse_bounded(match[3], 0 if absolute else 1, _LAST_STEP))


def _build_move_register(match: re.Match[str]) -> Statement:
    return MoveSteps(_parse_sign(match[2]), bool(match[1]), UserRegister(parse_bounded(match[3], 1, 510)))


def _build_move_analogue(match: re.Match[str]) -> Statement:
    absolute = bool(match[1])
    low = 0 if absolute else 1
    scaled_input = ScaledInput(
        _parse_analogue_number(match[3]), parse_bounded(match[4], low, 65_000), parse_bounded(match[5], low, 65_000)
    )
    return MoveAnalogue(_parse_sign(match[2]), absolute, scaled_input)


def _build_run_on(match: re.Match[str]) -> Statement:
    _require_no_argument(match[2])
    return RunOn(_parse_sign(match[1]))


def _build_home(match: re.Match[str]) -> Statement:
    _require_no_argument(match[2])
    return SearchHome(_parse_sign(match[1]))


def _build_arm(match: re.Match[str]) -> Statement:
    _require_no_argument(match[5])
    start, stop = parse_bounded(match[1], 1, 3), parse_bounded(match[2], 1, 3)
    start_level, stop_level = int(match[3]), int(match[4])
    begin = InputLevel(start, bool(start_level)) if start_level < _LOGIC_LEVELS else None
    end = {0: FallingInput(stop), 1: InputLevel(stop, level=True)}.get(stop_level)
    return ArmMove(3, begin, end)


def _parse_threshold(input_: str, comparison: str, reference: str) -> AnalogueThreshold:
    return AnalogueThreshold(_parse_analogue_number(input_), comparison == ">", parse_bounded(reference, 0, 255))


def _build_arm_analogue(match: re.Match[str]) -> Statement:
    start = _parse_threshold(match[2], match[3], match[4]) if match[1] != "X" else None
    stop = _parse_threshold(match[6], match[7], match[8]) if match[5] != "X" else None
    return ArmMove(7, start, stop)


def _build_current(match: re.Match[str]) -> Statement:
    return SetCurrent(match[1], parse_bounded(match[2], 0, _CURRENT_DIGITS))


def _build_rate(match: re.Match[str]) -> Statement:
    rate = cast(Rate, match[1])
    return SetRate(rate, parse_bounded(match[2], *RANGES[rate], "E5"))


def _build_rate_from_analogue(match: re.Match[str]) -> Statement:
    input_, scale = _parse_analogue_number(match[2]), parse_bounded(match[3], 1, 10)
    letter = match[1]
    return RateFromAnalogue("R" if letter == "r" else "S" if letter == "s" else "T", input_, scale)


def _build_output(match: re.Match[str]) -> Statement:
    return SetOutput(parse_bounded(match[2], 1, 3), match[1] == "A")


def _build_until(match: re.Match[str]) -> Statement:
    return RepeatUntil(_parse_contact(match[1], match[2]))


def _build_wait_for(match: re.Match[str]) -> Statement:
    return WaitFor(_parse_contact(match[1], match[2]))


def _build_delay(match: re.Match[str]) -> Statement:
    return DelayTicks(parse_bounded(match[1], 1, _LAST_DELAY))


def _build_delay_analogue(match: re.Match[str]) -> Statement:
    low, high = parse_bounded(match[2], 1, _LAST_DELAY), parse_bounded(match[3], 1, _LAST_DELAY)
    return DelayAnalogue(ScaledInput(_parse_analogue_number(match[1]), low, high))


def _build_jump(match: re.Match[str]) -> Statement:
    return JumpToLine(_parse_line_number(match[1]))


def _build_jump_pattern(match: re.Match[str]) -> Statement:
    return JumpPattern(parse_bounded(match[1], 0, 7), _parse_line_number(match[2]))


def _build_jump_level(match: re.Match[str]) -> Statement:
    return JumpLevel(
        _parse_contact(match[1], match[2]), bool(parse_bounded(match[3], 0, 1)), _parse_line_number(match[4])
    )


def _build_jump_threshold(match: re.Match[str]) -> Statement:
    return JumpThreshold(_parse_threshold(match[1], match[2], match[3]), _parse_line_number(match[4]))


def _build_call(match: re.Match[str]) -> Statement:
    return CallSubroutine(_parse_line_number(match[1]))


def _build_return(match: re.Match[str]) -> Statement:
    _require_no_argument(match[1])
    return ReturnFromCall()


def _build_loop(match: re.Match[str]) -> Statement:
    return LoopSegment(parse_bounded(match[1], 0, 255))


def _build_convert(match: re.Match[str]) -> Statement:
    if len(match[1]) > 4 or len(match[2] or "") > 4:
        raise StatementRefused("E2")
    factor = int(match[1]) * 10_000 + int((match[2] or "").ljust(4, "0"))
    if not 1 <= factor <= 16_000_000:
        raise StatementRefused("E4")
    return SetConversion(factor)


def _build_print(match: re.Match[str]) -> Statement:
    module = parse_bounded(match[1], 1, _PC)
    if 31 < module < _PC:
        raise StatementRefused("E4")
    content: Operand | str = match[4] if match[4] is not None else read_operand(match[3])
    return PrintText(module, parse_bounded(match[2], 0, 255), content)


def _build_if(match: re.Match[str]) -> Statement:
    return IfComparison(read_operand(match[1]), cast(Comparison, match[2]), read_operand(match[3]))


def _build_input(match: re.Match[str]) -> Statement:
    value_range = None
    if match[4] is not None:
        low, high = (match[4], match[5]) if match[5] is not None else ("0", match[4])
        value_range = (parse_bounded(low, 0, WORD), parse_bounded(high, 0, WORD))
    return ReadInput(
        read_target(match[1]), parse_bounded(match[2], 0, 31), parse_bounded(match[3], 0, 255), value_range
    )


def _build_assign(match: re.Match[str]) -> Statement:
    target, operand = read_target(match[1]), match[2]
    if match[3] is not None:
        return AssignRegister(target, read_operand(operand), cast(Operator, match[3]), read_operand(match[4]))
    if isinstance(target, PredefinedRegister) and operand.isdigit() and target.letter in ("R", "S", "T"):
        # T=2000 is T2000 (L3000), so its bounds apply as well.
        parse_bounded(operand, *RANGES[target.letter], "E5")
    return AssignRegister(target, read_operand(operand))


def _build_flag(match: re.Match[str]) -> Statement:
    return SetFlag(parse_bounded(match[2], 1, 31), parse_bounded(match[3], 1, 255), match[1] == "A")


_THRESHOLD = r"(X|A(\d+)([<>])(\d+))"
_FORMS: list[tuple[re.Pattern[str], Builder]] = [
    (re.compile(form), builder)
    for form, builder in (
        (r"f([+-])(\d+)", _build_force),
        (r"I(\d+)", _build_initialize),
        (r"(G?)([+-])(\d+)", _build_move),
        (r"(G?)([+-])\(R(\d+)\)", _build_move_register),
        (r"(G?)([+-])A(\d+)\.(\d+)-(\d+)", _build_move_analogue),
        (r"g([+-])(\d*)", _build_run_on),
        (r"H([+-])(\d*)", _build_home),
        (r"N(\d)(\d)\.(\d)(\d)(\d*)", _build_arm),
        (rf"NA{_THRESHOLD}\.{_THRESHOLD}", _build_arm_analogue),
        (r"(C[SRT])(\d+)", _build_current),
        (r"(RT|RS|R|S|T)(\d+)", _build_rate),
        (r"([rst])(\d+)\.(\d+)", _build_rate_from_analogue),
        (r"([AC])(\d+)", _build_output),
        (r"U(A?)(\d+)", _build_until),
        (r"W(A?)(\d+)", _build_wait_for),
        (r"D(\d+)", _build_delay),
        (r"DA(\d+)\.(\d+)-(\d+)", _build_delay_analogue),
        (r"J(\d+)", _build_jump),
        (r"JC(\d+)\.(\d+)", _build_jump_pattern),
        (r"JC(A?)(\d+)=(\d+)\.(\d+)", _build_jump_level),
        (r"JCA(\d+)([<>])(\d+)\.(\d+)", _build_jump_threshold),
        (r"JS(\d+)", _build_call),
        (r"RET(\d*)", _build_return),
        (r"L(\d+)", _build_loop),
        (r"con=(\d+)(?:\.(\d+))?", _build_convert),
        (r'PRINT(\d+)\.(\d+)\.(?:([^"]+)|"([^"]*)")', _build_print),
        (r"IF([^<>=]+)(<=|>=|<>|<|>|=)([^<>=]+)", _build_if),
        (r"([^=]+)=INPUT(\d+)\.(\d+)(?:\.(\d+)(?:-(\d+))?)?", _build_input),
        (r"(R|S|T|D|L|R\d+|R\(R\d+\))=([^=+*/-]+)(?:([+*/-])([^=+*/-]+))?", _build_assign),
        (r"([AC])O(\d+)\.(\d+)", _build_flag),
    )
]


def strip_blanks(text: str) -> str:
    """Return `text` without blanks outside quotes (decision 5)."""
    if " " not in text:
        return text
    parts = text.split('"')
    parts[::2] = [part.replace(" ", "") for part in parts[::2]]
    return '"'.join(parts)


def read_statement(text: str) -> Statement:
    """Parse compact `text`. `StatementRefused` for text that cannot be a program line."""
    if not text:
        return BlankLine()
    for form, builder in _FORMS:
        if match := form.fullmatch(text):
            return builder(match)
    raise StatementRefused("E4")
