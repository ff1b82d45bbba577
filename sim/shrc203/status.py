"""Polled status of the controller: `!:`, `Q:`, `SRQ:` (section 7)."""

import re
from fractions import Fraction

from sim.shrc203.axis import AxisPhase, RunKind, StageAxis
from sim.shrc203.grammar import GROUPS, CommandRefused, format_decimal, pulse_size
from sim.shrc203.unit import StageSystem

_ERROR_BITS = {
    "S1": 0x4,
    "S2": 0x8,
    "S4": 0x10,
    "EMERGENCY": 0x20,
    "S3": 0x40,
    "S5": 0x80,
    "S6": 0x100,
    "S9": 0x200,
    "S7": 0x1000,
    "S10": 0x4000,
}
ERRORS = frozenset(_ERROR_BITS)
"""Device errors that an axis can have (L448)."""
_NORMAL, _COMMAND_ERROR = 0x1, 0x2
_OUT_READY, _OUT_BUSY = 0x8000, 0x10000
_ZERO_RETURN, _ORIGIN_RETURN = 0x20000, 0x40000
_CW, _CCW, _SOFT_CW, _SOFT_CCW = 0x80000, 0x100000, 0x200000, 0x400000
_NEAR, _ORG = 0x800000, 0x1000000

_LIMIT_LETTERS: dict[tuple[int, ...], str] = {
    (): "K",
    (0,): "1",
    (1,): "2",
    (2,): "3",
    (0, 1): "C",
    (0, 2): "D",
    (1, 2): "E",
    (0, 1, 2): "W",
}
"""Field s of Q: by the axes stopped by a limit sensor (L432-L446)."""
_RETURN_BITS = {RunKind.ORIGIN: _ORIGIN_RETURN, RunKind.ZERO: _ZERO_RETURN}
_DETAILED = re.compile(r"S([NUMDP]?)([EC]?)")


def status_word(unit: StageSystem, axis: StageAxis, at_ns: int) -> int:
    """Return the 25-bit status word of an axis (L519-L567); 0 for an invalid one. Forward is CW."""
    if not axis.controllable:
        return 0
    position = unit.drive.output_position(axis, at_ns)
    bits = _error_bits(axis) | _sensor_bits(axis, position)
    if axis.run is not None:
        bits |= _RETURN_BITS.get(axis.run.kind, 0)
    if axis.closed_loop:
        is_away = unit.drive.scale_position(axis, at_ns) != position
        settling = axis.phase is AxisPhase.SETTLING and unit.options.settle_ms > 0
        if is_away or settling:
            bits |= _OUT_BUSY if axis.is_busy else _OUT_READY
    if unit.options.near_pls and abs(position - axis.origin) <= unit.options.near_pls:
        bits |= _NEAR
    return bits


def _error_bits(axis: StageAxis) -> int:
    """Return the bits of the errors; without one, the bit of the normal state."""
    bits = _COMMAND_ERROR if axis.command_error else 0
    for error in axis.errors:
        bits |= _ERROR_BITS[error]
    return bits or _NORMAL


def _sensor_bits(axis: StageAxis, position: int) -> int:
    """Return the bits of limit sensors, software limits and the ORG sensor."""
    bits = _CW if axis.limit_on(1, position) else 0
    if axis.limit_on(-1, position):
        bits |= _CCW
    if axis.soft_stop:
        bits |= _SOFT_CW if axis.soft_stop > 0 else _SOFT_CCW
    if axis.home_sensor if axis.home_sensor is not None else position == axis.origin:
        bits |= _ORG
    return bits


def _busy_letter(unit: StageSystem) -> str:
    return "B" if any(axis.is_busy for axis in unit.controllable) else "R"


def _format_summary(unit: StageSystem) -> str:
    """Fields e, s, r of Q: and SRQ: (L426-L452)."""
    if any(axis.errors for axis in unit.controllable):
        stop = "R"
    else:
        stop = _LIMIT_LETTERS[tuple(axis.index for axis in unit.controllable if axis.limit_stop)]
    return f"{'X' if unit.command_error else 'K'},{stop},{_busy_letter(unit)}"


def _axis_state(axis: StageAxis) -> str:
    if not axis.controllable:
        return "D"
    return "B" if axis.is_busy else "R"


def _named_axes(unit: StageSystem, letter: str) -> list[StageAxis]:
    """Return the addressed axes, invalid ones too (decision 32)."""
    if letter in ("", "W"):
        return unit.controllable
    if letter not in GROUPS:
        raise CommandRefused
    return [unit.axes[index] for index in GROUPS[letter]]


def answer_positioning(unit: StageSystem, text: str) -> str:
    """!: and !:aS (L329-L400)."""
    if not text:
        return _busy_letter(unit)
    if text[-1] != "S":
        raise CommandRefused
    return ",".join(_axis_state(axis) for axis in _named_axes(unit, text[:-1]))


def answer_status(unit: StageSystem, text: str) -> str:
    """SRQ: and SRQ:aS (L593-L729)."""
    if not text:
        return _format_summary(unit)
    if text[-1] != "S":
        raise CommandRefused
    axes = _named_axes(unit, text[:-1])
    at_ns = unit.time.now_ns()
    return ",".join([*(f"{status_word(unit, axis, at_ns):X}" for axis in axes), *(_axis_state(axis) for axis in axes)])


def answer_coordinates(unit: StageSystem, text: str) -> str:
    """Q: and Q:Suc (L402-L591)."""
    at_ns = unit.time.now_ns()
    if not text:
        fields = [unit.command_coordinate(axis, at_ns) if axis.controllable else 0 for axis in unit.axes]
        return ",".join([*(f"{'-' if c < 0 else '+'}{abs(c):9d}" for c in fields), _format_summary(unit)])
    match = _DETAILED.fullmatch(text)
    if match is None:
        raise CommandRefused
    letter, counter = match.groups()
    values = [
        _format_in_unit(unit, axis, letter or axis.stage_unit, scale=counter == "E", at_ns=at_ns) for axis in unit.axes
    ]
    words = [f"{status_word(unit, axis, at_ns):X}" for axis in unit.axes]
    return ",".join([*values, *words, *(_axis_state(axis) for axis in unit.axes)])


def _format_in_unit(unit: StageSystem, axis: StageAxis, letter: str, at_ns: int, *, scale: bool) -> str:
    """Format unit letter, sign and value of a coordinate (decision 15); 0 for an invalid axis (L511)."""
    if not axis.controllable:
        return "0"
    value = unit.scale_coordinate(axis, at_ns) if scale else unit.command_coordinate(axis, at_ns)
    if letter == "D" and axis.deg_per_pulse is None:
        # A linear stage has no degrees; the other axes of the reply may.
        number = Fraction(0)
    elif letter == "P" and scale:
        number = Fraction(value) * axis.nm_per_pulse / unit.options.scale_resolution_nm
    else:
        number = value * pulse_size(axis, letter)
    decimals = unit.options.fixed_decimals if letter != "P" else None
    text = format_decimal(number, decimals)
    return f"{letter}{'+' if number > 0 else ''}{text}"
