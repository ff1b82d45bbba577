"""The command list: from a line to its reply, by mode (section 12)."""

from collections.abc import Callable
from dataclasses import dataclass

from sim.shrc203 import moves, settings, status, stores
from sim.shrc203.grammar import Refused
from sim.shrc203.line import CommandLine, Reply
from sim.shrc203.queries import identify, query
from sim.shrc203.unit import Area, Unit

_HOST = frozenset((Area.HOST,))
_HOST_PROGRAM = frozenset((Area.HOST, Area.PROGRAM))
_ALL = frozenset(Area)
_MODE = frozenset((Area.HOST, Area.PANEL, Area.PROGRAM_EDIT))
_IN_HIT = frozenset(("*IDN?", "?", "FMT", "MODE"))
_JOG_OVERRIDE_ALIAS = "JO"


@dataclass(frozen=True, slots=True)
class _Command:
    execute: Callable[[Unit, str, Reply, str], str]
    """Takes the unit, the text after the colon, where asynchronous lines go, and the text before the colon."""
    areas: frozenset[Area] = _HOST
    query: bool = False


def _setting(change: Callable[[Unit, str], None], areas: frozenset[Area] = _HOST) -> _Command:
    def execute(unit: Unit, text: str, reply: Reply, head: str) -> str:
        del reply, head
        change(unit, text)
        return "OK"

    return _Command(execute, areas)


def _asking(ask: Callable[[Unit, str], str], areas: frozenset[Area]) -> _Command:
    return _Command(lambda unit, text, _reply, _head: ask(unit, text), areas, query=True)


def _moving(act: Callable[[Unit, str, Reply], str], areas: frozenset[Area] = _HOST) -> _Command:
    return _Command(lambda unit, text, reply, _head: act(unit, text, reply), areas)


def _inputs(unit: Unit, text: str) -> str:
    """I: (L5256)."""
    if text:
        raise Refused
    return str(unit.inputs.value)


def _reset(unit: Unit, text: str) -> None:
    """RESET: (L2273); the restart follows the reply."""
    if text:
        raise Refused
    unit.restart_due = True


_COMMANDS: dict[str, _Command] = {
    "!": _asking(status.positioning, _HOST_PROGRAM),
    "Q": _asking(status.coordinates, _HOST_PROGRAM),
    "SRQ": _asking(status.status, _HOST_PROGRAM),
    "?": _asking(query, _ALL),
    "I": _asking(_inputs, _HOST),
    "PSET": _setting(settings.set_preset),
    "RESET": _setting(_reset),
    "SLEEP": _setting(settings.set_sleep),
    "BO": _setting(settings.set_display),
    "MODE": _setting(settings.set_mode, _MODE),
    "FMT": _setting(settings.set_format),
    "F": _setting(settings.set_loop),
    "C": _setting(settings.set_excitation),
    "BEC": _setting(settings.cancel_errors, _HOST_PROGRAM),
    "BEEP": _setting(settings.set_beep),
    "S": _setting(settings.set_division),
    "W": _setting(settings.set_wait),
    "D": _setting(settings.set_triple),
    "DS": _setting(settings.set_minimum_speed),
    "DF": _setting(settings.set_maximum_speed),
    "DR": _setting(settings.set_ramp),
    "JD": _setting(settings.override_jog),
    _JOG_OVERRIDE_ALIAS: _setting(settings.override_jog),
    "B": _setting(settings.set_origin_triple),
    "O": _setting(settings.set_outputs),
    "T": _setting(settings.set_trigger),
    "WT": _moving(moves.set_wait_time),
    "WI": _moving(moves.set_wait_input),
    "R": _moving(moves.zero),
    "RC": _moving(moves.cancel_zero),
    "L": _moving(moves.stop, _HOST_PROGRAM),
    "M": _moving(moves.set_relative),
    "MP": _moving(moves.set_relative_pre),
    "A": _moving(moves.set_absolute),
    "AP": _moving(moves.set_absolute_pre),
    "E": _moving(moves.set_arc),
    "EP": _moving(moves.set_arc_pre),
    "K": _moving(moves.set_line),
    "KP": _moving(moves.set_line_pre),
    "G": _moving(moves.start),
    "GC": _moving(moves.delete),
    "J": _moving(moves.set_jog),
    "Z": _Command(moves.return_to_zero),
    "ZRT": _Command(moves.return_to_zero),
    **{f"{head}{method}": _Command(moves.return_to_origin) for head in ("H", "HRT") for method in ("", *"01234")},
    "P": _moving(stores.program, frozenset((Area.HOST, Area.PROGRAM, Area.PROGRAM_EDIT))),
    "MS": _moving(stores.switches, frozenset((Area.HOST, Area.SWITCHES))),
    "PIT": _moving(stores.places),
    "PAV": _moving(stores.coordinates),
}
_ONLY_QUERIES = ("P:GET", "PIT:GET", "PAV:GET", "MS:GET", "MS:GETK", "MS:DEFR", "MS:DEFRK")
"""Queries among the families of commands; they leave the command-error flag alone (decision 16)."""


def answer(unit: Unit, line: CommandLine, reply: Reply) -> str:
    """Execute one line; the reply to it."""
    if not line.clean:
        unit.addressed = None
        _flag(unit)
        unit.previous = line.text
        return "NG_I"
    text = line.text if unit.options.strict_case else line.text.upper()
    if not unit.options.strict_blanks:
        text = text.replace(" ", "")
    unit.addressed = None
    is_query = False
    try:
        if not line.whole:
            raise Refused
        is_query, result = _dispatch(unit, text, reply)
    except Refused:
        is_query = is_query or _asks(text)
        if not is_query:
            _flag(unit)
        result = "NG"
    else:
        if not is_query:
            _unflag(unit)
    unit.previous = line.text
    return result


def _dispatch(unit: Unit, text: str, reply: Reply) -> tuple[bool, str]:
    if text == "*IDN?":
        return True, identify(unit)
    head, colon, rest = text.partition(":")
    command = _COMMANDS.get(head)
    if not colon:
        if text != "G":
            raise Refused
        head, command = "G", _COMMANDS["G"]
    if command is None or unit.area not in command.areas:
        raise Refused
    if unit.format == "HIT" and head not in _IN_HIT:
        raise Refused
    if head == _JOG_OVERRIDE_ALIAS and unit.options.jo_refused:
        raise Refused
    # In program mode only the emergency stop stops (L5498).
    if head == "L" and unit.area is Area.PROGRAM and rest != "E":
        raise Refused
    return command.query or _asks(text), command.execute(unit, rest, reply, head)


def _asks(text: str) -> bool:
    head = text.partition(":")[0]
    command = _COMMANDS.get(head)
    return (command is not None and command.query) or text.partition(",")[0] in _ONLY_QUERIES


def _flag(unit: Unit) -> None:
    """A refused setting command marks the axes that it names, or all (decision 16)."""
    unit.command_error = True
    for axis in unit.controllable if unit.addressed is None else unit.addressed:
        axis.command_error = True


def _unflag(unit: Unit) -> None:
    if unit.command_error:
        unit.command_error = False
        for axis in unit.axes:
            axis.command_error = False
