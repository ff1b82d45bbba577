"""The `?:` queries (section 7.5)."""

from collections.abc import Callable

from sim.shrc203.axis import Axis
from sim.shrc203.entries import Arc, Entry, Jog, Line, Travel, WaitInput, WaitTime
from sim.shrc203.grammar import GROUPS, Refused, decimal, in_unit, letter_of
from sim.shrc203.switches import AXIS_CODES
from sim.shrc203.unit import MODEL, Area, Unit

_NOT_SET = "NS"
_CONFIG_REPLIES = {"off": "0", "ok": "1", "error": "E", "missing": "D"}

AxisQuery = Callable[[Unit, Axis, str], str]
UnitQuery = Callable[[Unit, str], str]


def identify(unit: Unit) -> str:
    """*IDN? (decision 50: no blank after the comma)."""
    return f"SIGMAKOKI,{MODEL},{unit.options.serial},{unit.options.firmware}"


def _travel(entry: Entry | None, absolute: bool, axis: Axis, letter: str) -> str:
    if isinstance(entry, Travel) and entry.absolute is absolute:
        return in_unit(axis, letter, entry.pulses)
    return _NOT_SET


def _jog(unit: Unit, axis: Axis, letter: str) -> str:
    del unit, letter
    return ("+" if axis.execution.sign > 0 else "-") if isinstance(axis.execution, Jog) else _NOT_SET


def _wait_time(unit: Unit, axis: Axis, letter: str) -> str:
    del unit, letter
    return str(axis.pre.tenths) if isinstance(axis.pre, WaitTime) else _NOT_SET


def _wait_input(unit: Unit, axis: Axis, letter: str) -> str:
    del unit, letter
    return str(axis.pre.pattern) if isinstance(axis.pre, WaitInput) else _NOT_SET


_BY_AXIS: dict[str, tuple[str, AxisQuery]] = {
    "R": ("", lambda unit, _a, _u: str(unit.options.scale_resolution_nm)),
    "P": ("", lambda _, axis, _u: decimal(axis.nm_per_pulse)),
    "S": ("", lambda _, axis, _u: str(axis.divide)),
    "AN": ("", lambda _, axis, _u: axis.axis_name),
    "D": ("", lambda _, axis, _u: str(axis.triple)),
    "DS": ("FNUMD", lambda _, axis, letter: in_unit(axis, letter, axis.triple.s)),
    "DF": ("FNUMD", lambda _, axis, letter: in_unit(axis, letter, axis.triple.f)),
    "DR": ("", lambda _, axis, _u: str(axis.triple.r)),
    "B": ("", lambda _, axis, _u: str(axis.origin_triple)),
    "M": ("PNUMD", lambda _, axis, letter: _travel(axis.execution, False, axis, letter)),
    "MP": ("PNUMD", lambda _, axis, letter: _travel(axis.pre, False, axis, letter)),
    "A": ("PNUMD", lambda _, axis, letter: _travel(axis.execution, True, axis, letter)),
    "AP": ("PNUMD", lambda _, axis, letter: _travel(axis.pre, True, axis, letter)),
    "WT": ("", _wait_time),
    "WI": ("", _wait_input),
    "J": ("", _jog),
    "ACS": ("", lambda _, axis, _u: _CONFIG_REPLIES[axis.config]),
    "C": ("", lambda _, axis, _u: str(int(axis.excited))),
    "F": ("", lambda _, axis, _u: str(int(not axis.closed_loop))),
}
"""Queries with an axis letter: the unit letters they take (the first is the default), and one axis's reply."""


def _arc(unit: Unit, letter: str, pre: bool) -> str:
    for axis in unit.axes:
        entry = axis.pre if pre else axis.execution
        if isinstance(entry, Arc):
            return _arc_text(entry, letter)
    return _NOT_SET


def _arc_text(arc: Arc, letter: str) -> str:
    """Kind, axis letter, direction, then the values in the order of the command (L1492-L1503)."""
    fields = [str(arc.form), letter_of(arc.plane), str(int(arc.ccw))]
    if arc.form == 3:
        fields.append(str(arc.rotations))
    fields += [in_unit(arc.plane[at % 2], letter, value) for at, value in enumerate(arc.values)]
    if arc.angle is not None:
        fields.append(decimal(arc.angle))
    if arc.linear is not None:
        fields.append(in_unit(arc.linear, letter, arc.rise))
    return ",".join(fields)


def _line(unit: Unit, letter: str, pre: bool) -> str:
    for axis in unit.axes:
        entry = axis.pre if pre else axis.execution
        if isinstance(entry, Line):
            amounts = zip(entry.axes, entry.pulses, strict=True)
            return ",".join([letter_of(entry.axes), *(in_unit(of, letter, value) for of, value in amounts)])
    return _NOT_SET


def mode_text(unit: Unit) -> str:
    """The mode as ?:MODE names it (L2009)."""
    if unit.area in (Area.PROGRAM, Area.PROGRAM_EDIT):
        return "HOST,PROGRAM"
    return "HOST,MS" if unit.area is Area.SWITCHES else unit.mode


def _program(unit: Unit, letter: str) -> str:
    """?:L: program, state, line, what remains of the nine loops (L2090)."""
    del letter
    run = unit.program
    return ",".join(str(value) for value in (unit.programs.selected, int(run.state), run.line, *run.loops))


_BY_UNIT: dict[str, tuple[str, UnitQuery]] = {
    "V": ("", lambda unit, _: unit.options.firmware),
    "N": ("", lambda _unit, _: MODEL),
    "SN": ("", lambda unit, _: unit.options.serial),
    "AXIS": ("", lambda unit, _: str(AXIS_CODES.index(tuple(axis.index + 1 for axis in unit.controllable)))),
    "E": ("PNUMD", lambda unit, letter: _arc(unit, letter, False)),
    "EP": ("PNUMD", lambda unit, letter: _arc(unit, letter, True)),
    "K": ("PNUMD", lambda unit, letter: _line(unit, letter, False)),
    "KP": ("PNUMD", lambda unit, letter: _line(unit, letter, True)),
    "O": ("", lambda unit, _: str(unit.outputs.value)),
    "W": ("", lambda unit, _: str(unit.drive.wait_tenths)),
    "SLEEP": ("", lambda unit, _: str(int(unit.sleeping))),
    "BO": ("", lambda unit, _: str(int(unit.display))),
    "BEEP": ("", lambda unit, _: str(int(unit.beep))),
    "MODE": ("", lambda unit, _: mode_text(unit)),
    "FMT": ("", lambda unit, _: unit.format),
    "CMD": ("", lambda unit, _: unit.previous),
    "L": ("", _program),
    "T": ("", lambda unit, _: str(unit.trigger.setting or _NOT_SET)),
}
"""Queries about the whole unit."""

_LETTERS = ("", "W", *GROUPS)
_ITEMS = {f"{name}{letter}": (name, letter) for name in _BY_AXIS for letter in _LETTERS}
_ANYWHERE = frozenset(("MODE", "CMD"))
"""Usable in all modes (L298)."""
_IN_HIT = frozenset(("MODE", "CMD", "FMT", "N"))


def query(unit: Unit, text: str) -> str:
    """?:… ; an unknown item is NG (decision 51)."""
    item, comma, letter = text.partition(",")
    if unit.area in (Area.PANEL, Area.PROGRAM_EDIT) and item not in _ANYWHERE:
        raise Refused
    if unit.format == "HIT" and item not in _IN_HIT:
        raise Refused
    if item in _BY_UNIT:
        units, ask = _BY_UNIT[item]
        return ask(unit, _unit_letter(units, comma, letter))
    if item not in _ITEMS:
        raise Refused
    name, axis_letter = _ITEMS[item]
    units, ask_axis = _BY_AXIS[name]
    letter = _unit_letter(units, comma, letter)
    return ",".join(ask_axis(unit, axis, letter) for axis in unit.group(axis_letter))


def _unit_letter(units: str, comma: str, letter: str) -> str:
    if not comma:
        return units[:1]
    if len(letter) != 1 or letter not in units:
        raise Refused
    return letter
