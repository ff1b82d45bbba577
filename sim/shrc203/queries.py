"""The `?:` queries (section 7.5)."""

from collections.abc import Callable

from sim.shrc203.axis import StageAxis
from sim.shrc203.entries import ArcMove, InputStandby, JogMove, LinearMove, TimedStandby, TravelMove
from sim.shrc203.grammar import GROUPS, CommandRefused, axis_letter, format_decimal, format_in_unit
from sim.shrc203.switches import AXIS_CODES
from sim.shrc203.unit import MODEL, CommandArea, StageSystem

_NOT_SET = "NS"
_CONFIG_REPLIES = {"off": "0", "ok": "1", "error": "E", "missing": "D"}

AxisQuery = Callable[[StageSystem, StageAxis, str], str]
UnitQuery = Callable[[StageSystem, str], str]


def answer_identity(unit: StageSystem) -> str:
    """*IDN? (decision 50: no blank after the comma)."""
    return f"SIGMAKOKI,{MODEL},{unit.options.serial},{unit.options.firmware}"


def _travel_query(*, absolute: bool, pre: bool) -> AxisQuery:
    """Make the query of the amount or target in the execution buffer, or in the prebuffer."""

    def format_travel(unit: StageSystem, axis: StageAxis, letter: str) -> str:
        buffers = unit.chain.buffers[axis]
        entry = buffers.pre if pre else buffers.execution
        if isinstance(entry, TravelMove) and entry.absolute is absolute:
            return format_in_unit(axis, letter, entry.pulses)
        return _NOT_SET

    return format_travel


def _format_jog(unit: StageSystem, axis: StageAxis, letter: str) -> str:
    del letter
    entry = unit.chain.buffers[axis].execution
    return ("+" if entry.sign > 0 else "-") if isinstance(entry, JogMove) else _NOT_SET


def _format_wait_time(unit: StageSystem, axis: StageAxis, letter: str) -> str:
    del letter
    entry = unit.chain.buffers[axis].pre
    return str(entry.tenths) if isinstance(entry, TimedStandby) else _NOT_SET


def _format_wait_input(unit: StageSystem, axis: StageAxis, letter: str) -> str:
    del letter
    entry = unit.chain.buffers[axis].pre
    return str(entry.pattern) if isinstance(entry, InputStandby) else _NOT_SET


_BY_AXIS: dict[str, tuple[str, AxisQuery]] = {
    "R": ("", lambda unit, _a, _u: str(unit.options.scale_resolution_nm)),
    "P": ("", lambda _, axis, _u: format_decimal(axis.nm_per_pulse)),
    "S": ("", lambda _, axis, _u: str(axis.divide)),
    "AN": ("", lambda _, axis, _u: axis.axis_name),
    "D": ("", lambda _, axis, _u: str(axis.triple)),
    "DS": ("FNUMD", lambda _, axis, letter: format_in_unit(axis, letter, axis.triple.s)),
    "DF": ("FNUMD", lambda _, axis, letter: format_in_unit(axis, letter, axis.triple.f)),
    "DR": ("", lambda _, axis, _u: str(axis.triple.r)),
    "B": ("", lambda _, axis, _u: str(axis.origin_triple)),
    "M": ("PNUMD", _travel_query(absolute=False, pre=False)),
    "MP": ("PNUMD", _travel_query(absolute=False, pre=True)),
    "A": ("PNUMD", _travel_query(absolute=True, pre=False)),
    "AP": ("PNUMD", _travel_query(absolute=True, pre=True)),
    "WT": ("", _format_wait_time),
    "WI": ("", _format_wait_input),
    "J": ("", _format_jog),
    "ACS": ("", lambda _, axis, _u: _CONFIG_REPLIES[axis.config]),
    "C": ("", lambda _, axis, _u: str(int(axis.excited))),
    "F": ("", lambda _, axis, _u: str(int(not axis.closed_loop))),
}
"""Queries with an axis letter: the unit letters they accept (the first is the default), and one axis's reply."""


def _format_arc(unit: StageSystem, letter: str, *, pre: bool) -> str:
    for axis in unit.axes:
        buffers = unit.chain.buffers[axis]
        entry = buffers.pre if pre else buffers.execution
        if isinstance(entry, ArcMove):
            return _arc_text(entry, letter)
    return _NOT_SET


def _arc_text(arc: ArcMove, letter: str) -> str:
    """Format kind, axis letter, direction, then the values in the order of the command (L1492-L1503)."""
    fields = [str(arc.form), axis_letter(arc.plane), str(int(arc.ccw))]
    if arc.form == 3:
        fields.append(str(arc.rotations))
    fields += [format_in_unit(arc.plane[at % 2], letter, value) for at, value in enumerate(arc.values)]
    if arc.angle is not None:
        fields.append(format_decimal(arc.angle))
    if arc.linear is not None:
        fields.append(format_in_unit(arc.linear, letter, arc.rise))
    return ",".join(fields)


def _format_line(unit: StageSystem, letter: str, *, pre: bool) -> str:
    for axis in unit.axes:
        buffers = unit.chain.buffers[axis]
        entry = buffers.pre if pre else buffers.execution
        if isinstance(entry, LinearMove):
            amounts = zip(entry.axes, entry.pulses, strict=True)
            return ",".join([axis_letter(entry.axes), *(format_in_unit(of, letter, value) for of, value in amounts)])
    return _NOT_SET


def mode_text(unit: StageSystem) -> str:
    """Return the mode as ?:MODE names it (L2009)."""
    if unit.area in (CommandArea.PROGRAM, CommandArea.PROGRAM_EDIT):
        return "HOST,PROGRAM"
    return "HOST,MS" if unit.area is CommandArea.SWITCHES else unit.mode


def _format_program(unit: StageSystem, letter: str) -> str:
    """?:L: program, state, line, remaining count of the nine loops (L2090)."""
    del letter
    run = unit.program
    return ",".join(str(value) for value in (unit.programs.selected, int(run.state), run.line, *run.loops))


_BY_UNIT: dict[str, tuple[str, UnitQuery]] = {
    "V": ("", lambda unit, _: unit.options.firmware),
    "N": ("", lambda _unit, _: MODEL),
    "SN": ("", lambda unit, _: unit.options.serial),
    "AXIS": ("", lambda unit, _: str(AXIS_CODES.index(tuple(axis.index + 1 for axis in unit.controllable)))),
    "E": ("PNUMD", lambda unit, letter: _format_arc(unit, letter, pre=False)),
    "EP": ("PNUMD", lambda unit, letter: _format_arc(unit, letter, pre=True)),
    "K": ("PNUMD", lambda unit, letter: _format_line(unit, letter, pre=False)),
    "KP": ("PNUMD", lambda unit, letter: _format_line(unit, letter, pre=True)),
    "O": ("", lambda unit, _: str(unit.outputs.value)),
    "W": ("", lambda unit, _: str(unit.drive.wait_tenths)),
    "SLEEP": ("", lambda unit, _: str(int(unit.sleeping))),
    "BO": ("", lambda unit, _: str(int(unit.display))),
    "BEEP": ("", lambda unit, _: str(int(unit.beep))),
    "MODE": ("", lambda unit, _: mode_text(unit)),
    "FMT": ("", lambda unit, _: unit.format),
    "CMD": ("", lambda unit, _: unit.previous),
    "L": ("", _format_program),
    "T": ("", lambda unit, _: str(unit.trigger.setting or _NOT_SET)),
}
"""Queries about the whole controller."""

_LETTERS = ("", "W", *GROUPS)
_ITEMS = {f"{name}{letter}": (name, letter) for name in _BY_AXIS for letter in _LETTERS}
_ANYWHERE = frozenset(("MODE", "CMD"))
"""Usable in all modes (L298)."""
_IN_HIT = frozenset(("MODE", "CMD", "FMT", "N"))


def answer_query(unit: StageSystem, text: str) -> str:
    """?:… ; an unknown item is NG (decision 51)."""
    item, comma, letter = text.partition(",")
    if unit.area in (CommandArea.PANEL, CommandArea.PROGRAM_EDIT) and item not in _ANYWHERE:
        raise CommandRefused
    if unit.format == "HIT" and item not in _IN_HIT:
        raise CommandRefused
    if item in _BY_UNIT:
        units, unit_query = _BY_UNIT[item]
        return unit_query(unit, _unit_letter(units, comma, letter))
    if item not in _ITEMS:
        raise CommandRefused
    name, axis_letter = _ITEMS[item]
    units, axis_query = _BY_AXIS[name]
    letter = _unit_letter(units, comma, letter)
    return ",".join(axis_query(unit, axis, letter) for axis in unit.resolve_axes(axis_letter))


def _unit_letter(units: str, comma: str, letter: str) -> str:
    if not comma:
        return units[:1]
    if len(letter) != 1 or letter not in units:
        raise CommandRefused
    return letter
