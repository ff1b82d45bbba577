"""Command list: from a line to its reply, by mode (section 12)."""

from collections.abc import Callable
from dataclasses import dataclass

from sim.shrc203 import moves, settings, status, stores
from sim.shrc203.grammar import CommandRefused
from sim.shrc203.line import ReceivedLine, Reply
from sim.shrc203.queries import answer_identity, answer_query
from sim.shrc203.unit import CommandArea, StageSystem

_HOST = frozenset((CommandArea.HOST,))
_HOST_PROGRAM = frozenset((CommandArea.HOST, CommandArea.PROGRAM))
_ALL = frozenset(CommandArea)
_MODE = frozenset((CommandArea.HOST, CommandArea.PANEL, CommandArea.PROGRAM_EDIT))
_IN_HIT = frozenset(("*IDN?", "?", "FMT", "MODE"))
_JOG_OVERRIDE_ALIAS = "JO"


@dataclass(frozen=True, slots=True)
class _LineCommand:
    execute: Callable[[StageSystem, str, Reply, str], str]
    """Arguments: the unit, the text after the colon, the destination of asynchronous lines, and the text before the
    colon."""
    areas: frozenset[CommandArea] = _HOST
    query: bool = False


def _setting_command(change: Callable[[StageSystem, str], None], areas: frozenset[CommandArea] = _HOST) -> _LineCommand:
    def execute_setting(unit: StageSystem, text: str, reply: Reply, head: str) -> str:
        del reply, head
        change(unit, text)
        return "OK"

    return _LineCommand(execute_setting, areas)


def _query_command(answer_text: Callable[[StageSystem, str], str], areas: frozenset[CommandArea]) -> _LineCommand:
    return _LineCommand(lambda unit, text, _reply, _head: answer_text(unit, text), areas, query=True)


def _motion_command(
    act: Callable[[StageSystem, str, Reply], str], areas: frozenset[CommandArea] = _HOST
) -> _LineCommand:
    return _LineCommand(lambda unit, text, reply, _head: act(unit, text, reply), areas)


def _answer_inputs(unit: StageSystem, text: str) -> str:
    """I: (L5256)."""
    if text:
        raise CommandRefused
    return str(unit.inputs.value)


def _request_reset(unit: StageSystem, text: str) -> None:
    """RESET: (L2273); the restart follows the reply."""
    if text:
        raise CommandRefused
    unit.restart_due = True


_COMMANDS: dict[str, _LineCommand] = {
    "!": _query_command(status.answer_positioning, _HOST_PROGRAM),
    "Q": _query_command(status.answer_coordinates, _HOST_PROGRAM),
    "SRQ": _query_command(status.answer_status, _HOST_PROGRAM),
    "?": _query_command(answer_query, _ALL),
    "I": _query_command(_answer_inputs, _HOST),
    "PSET": _setting_command(settings.set_preset),
    "RESET": _setting_command(_request_reset),
    "SLEEP": _setting_command(settings.set_sleep),
    "BO": _setting_command(settings.set_display),
    "MODE": _setting_command(settings.set_mode, _MODE),
    "FMT": _setting_command(settings.set_format),
    "F": _setting_command(settings.set_loop),
    "C": _setting_command(settings.set_excitation),
    "BEC": _setting_command(settings.cancel_errors, _HOST_PROGRAM),
    "BEEP": _setting_command(settings.set_beep),
    "S": _setting_command(settings.set_division),
    "W": _setting_command(settings.set_wait),
    "D": _setting_command(settings.set_triple),
    "DS": _setting_command(settings.set_minimum_speed),
    "DF": _setting_command(settings.set_maximum_speed),
    "DR": _setting_command(settings.set_ramp),
    "JD": _setting_command(settings.override_jog),
    _JOG_OVERRIDE_ALIAS: _setting_command(settings.override_jog),
    "B": _setting_command(settings.set_origin_triple),
    "O": _setting_command(settings.set_outputs),
    "T": _setting_command(settings.set_trigger),
    "WT": _motion_command(moves.set_wait_time),
    "WI": _motion_command(moves.set_wait_input),
    "R": _motion_command(moves.zero_coordinate),
    "RC": _motion_command(moves.restore_coordinate),
    "L": _motion_command(moves.stop_motion, _HOST_PROGRAM),
    "M": _motion_command(moves.set_relative),
    "MP": _motion_command(moves.set_relative_pre),
    "A": _motion_command(moves.set_absolute),
    "AP": _motion_command(moves.set_absolute_pre),
    "E": _motion_command(moves.set_arc),
    "EP": _motion_command(moves.set_arc_pre),
    "K": _motion_command(moves.set_line),
    "KP": _motion_command(moves.set_line_pre),
    "G": _motion_command(moves.start_motion),
    "GC": _motion_command(moves.delete_entries),
    "J": _motion_command(moves.set_jog),
    "Z": _LineCommand(moves.return_to_zero),
    "ZRT": _LineCommand(moves.return_to_zero),
    **{f"{head}{method}": _LineCommand(moves.return_to_origin) for head in ("H", "HRT") for method in ("", *"01234")},
    "P": _motion_command(
        stores.execute_program_command, frozenset((CommandArea.HOST, CommandArea.PROGRAM, CommandArea.PROGRAM_EDIT))
    ),
    "MS": _motion_command(stores.execute_switch_command, frozenset((CommandArea.HOST, CommandArea.SWITCHES))),
    "PIT": _motion_command(stores.execute_position_record),
    "PAV": _motion_command(stores.execute_coordinate_record),
}
_ONLY_QUERIES = ("P:GET", "PIT:GET", "PAV:GET", "MS:GET", "MS:GETK", "MS:DEFR", "MS:DEFRK")
"""Queries among the families of commands; they leave the command-error flag unchanged (decision 16)."""


def answer_line(unit: StageSystem, line: ReceivedLine, reply: Reply) -> str:
    """Execute one line; return its reply."""
    if not line.clean:
        unit.addressed = None
        _set_error_flags(unit)
        unit.previous = line.text
        return "NG_I"
    text = line.text if unit.options.strict_case else line.text.upper()
    if not unit.options.strict_blanks:
        text = text.replace(" ", "")
    unit.addressed = None
    is_query = False
    try:
        if not line.whole:
            raise CommandRefused
        is_query, result = _dispatch_line(unit, text, reply)
    except CommandRefused:
        is_query = is_query or _is_query(text)
        if not is_query:
            _set_error_flags(unit)
        result = "NG"
    else:
        if not is_query:
            _clear_error_flags(unit)
    unit.previous = line.text
    return result


def _dispatch_line(unit: StageSystem, text: str, reply: Reply) -> tuple[bool, str]:
    if text == "*IDN?":
        return True, answer_identity(unit)
    head, colon, tail = text.partition(":")
    command = _COMMANDS.get(head)
    if not colon:
        if text != "G":
            raise CommandRefused
        head, command = "G", _COMMANDS["G"]
    if command is None or unit.area not in command.areas:
        raise CommandRefused
    if unit.format == "HIT" and head not in _IN_HIT:
        raise CommandRefused
    if head == _JOG_OVERRIDE_ALIAS and unit.options.jo_refused:
        raise CommandRefused
    # In program mode only the emergency stop works (L5498).
    if head == "L" and unit.area is CommandArea.PROGRAM and tail != "E":
        raise CommandRefused
    return command.query or _is_query(text), command.execute(unit, tail, reply, head)


def _is_query(text: str) -> bool:
    head = text.partition(":")[0]
    command = _COMMANDS.get(head)
    return (command is not None and command.query) or text.partition(",")[0] in _ONLY_QUERIES


def _set_error_flags(unit: StageSystem) -> None:
    """A refused setting command sets the flag of the axes that it names, or of all (decision 16)."""
    unit.command_error = True
    for axis in unit.controllable if unit.addressed is None else unit.addressed:
        axis.command_error = True


def _clear_error_flags(unit: StageSystem) -> None:
    if unit.command_error:
        unit.command_error = False
        for axis in unit.axes:
            axis.command_error = False
