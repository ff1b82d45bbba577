"""The eight stored programs and their line patterns (L5706-L7297)."""

import copy
import re
from dataclasses import dataclass
from fractions import Fraction

from sim.shrc203.grammar import MAX_PULSES, NUMBER, CommandRefused, format_decimal, parse_integer

PROGRAMS = 8
LINES = 4000
NESTS = 9
KEEP_TRIGGER, NO_TRIGGER, ONE_SHOT = 6, 5, 4

_AXES = ("as1", "as2", "as3")
_PLACES = ("ap1", "ap2", "ap3")
_TAIL = ("o", "s", "w")
_ARC = {0: ("c1", "c2"), 1: ("c1", "c2", "al"), 2: ("p1", "p2", "e1", "e2")}
_HELIX = {0: ("c1", "c2", "hl", "r"), 1: ("c1", "c2", "al", "hl"), 2: ("p1", "p2", "e1", "e2", "hl")}
_WAY = (-MAX_PULSES, MAX_PULSES)
_RANGES: dict[str, tuple[int, int]] = {
    **dict.fromkeys(_AXES, (0, 1)),
    **dict.fromkeys((*_PLACES, "c1", "c2", "p1", "p2", "e1", "e2", "hl"), _WAY),
    **dict.fromkeys(("m1", "m2", "m3"), (0, 20)),
    "cm": (0, 5),
    "r": (1, 1000),
    "o": (0, 63),
    "s": (1, 4),
    "w": (0, 2560),
    "tm": (0, 6),
    "ta": (1, 3),
    "i": (0, 63),
    "ll": (1, NESTS),
    "lv": (1, 65535),
}
_INTERVALS = {0: (2, 30000), 1: (1, 10000), 2: (2, 30000), 3: (2, 30000)}
_FIXED: dict[str, tuple[str, ...]] = {
    "M": (*_AXES, *_PLACES, *_TAIL),
    "A": (*_AXES, *_PLACES, *_TAIL),
    "K": (*_AXES, *_PLACES, *_TAIL),
    "CM": (*_AXES, *_PLACES, *_TAIL, "tm"),
    "CA": (*_AXES, *_PLACES, *_TAIL, "tm"),
    "PAV": (*_AXES, "m1", "m2", "m3", *_TAIL),
    "H": (*_AXES, "o", "w", "tm"),
    "Z": (*_AXES, *_TAIL, "tm"),
    "R": _AXES,
    "INPUT": ("i",),
    "F": ("ll", "lv"),
    "N": ("ll",),
    "END": (),
    "NONE": (),
}
_ENABLED = {"K": (2, 3), "CM": (1, 1), "CA": (1, 1), "E": (2, 2), "EH": (2, 2)}
"""Number of axes that must be enabled (L5810, L5852, L6101); the other patterns take one to three."""
_TRIGGERED = frozenset(("M", "A", "K", "E", "EH", "PAV"))
_OWN_TRIGGERS = {"CM": (0, 2), "CA": (0, 2), "H": (ONE_SHOT, NO_TRIGGER), "Z": (ONE_SHOT, NO_TRIGGER)}
_ANGLE = re.compile(NUMBER)


@dataclass(frozen=True, slots=True)
class ProgramLine:
    """One line: its pattern, its fields by the manual's names, and the text that P:GET returns."""

    pattern: str
    fields: dict[str, int]
    angle: Fraction
    """Field al, degrees."""
    text: str

    @property
    def axes(self) -> tuple[int, ...]:
        """Indices of the enabled axes."""
        return tuple(index for index, name in enumerate(_AXES) if self.fields.get(name))


_END = ProgramLine("END", {}, Fraction(0), "END")
NONE = ProgramLine("NONE", {}, Fraction(0), "NONE")


class _LineFields:
    """Reads the fields of a line one by one."""

    def __init__(self, texts: list[str]) -> None:
        self._texts = texts
        self.values: dict[str, int] = {}
        self.angle = Fraction(0)
        self.taken: list[str] = []

    def take_field(self, name: str, low: int, high: int) -> int:
        value = parse_integer(self._next_text(), low, high)
        self.values[name] = value
        self.taken.append(str(value))
        return value

    def take_fields(self, names: tuple[str, ...], max_degrees: int) -> None:
        for name in names:
            if name == "al":
                text = self._next_text()
                if not _ANGLE.fullmatch(text) or len(text) > 20 or Fraction(text) > max_degrees:
                    raise CommandRefused
                self.angle = Fraction(text)
                self.taken.append(format_decimal(self.angle))
            else:
                self.take_field(name, *_RANGES[name])

    def fields_left(self) -> int:
        return len(self._texts) - len(self.taken)

    def _next_text(self) -> str:
        if not self.fields_left():
            raise CommandRefused
        return self._texts[len(self.taken)]


def parse_line(texts: list[str]) -> ProgramLine:
    """Parse a line from its fields, pattern first. Raises `CommandRefused` for anything the manual does not allow."""
    pattern, fields = texts[0], _LineFields(texts[1:])
    if pattern in ("E", "EH"):
        fields.take_fields((*_AXES, "cm"), 0)
        forms, degrees = (_ARC, 360) if pattern == "E" else (_HELIX, 360_000)
        fields.take_fields((*forms[fields.values["cm"] // 2], *_TAIL), degrees)
    elif pattern in _FIXED:
        fields.take_fields(_FIXED[pattern], 0)
    else:
        raise CommandRefused
    if pattern in _TRIGGERED:
        _read_trigger(fields)
    if fields.fields_left():
        raise CommandRefused
    values = fields.values
    if pattern in _OWN_TRIGGERS and values["tm"] not in _OWN_TRIGGERS[pattern]:
        raise CommandRefused
    line = ProgramLine(pattern, values, fields.angle, ",".join([pattern, *fields.taken]))
    if "as1" in values:
        low, high = _ENABLED.get(pattern, (1, 3))
        if not low <= len(line.axes) <= high:
            raise CommandRefused
    if pattern == "PAV" and any(not values[f"m{index + 1}"] for index in line.axes):
        raise CommandRefused
    return line


def _read_trigger(fields: _LineFields) -> None:
    """Read tm, and ta and tv for the modes that have them (L5730); ta is 1 in timer mode (L5733)."""
    mode = fields.take_field("tm", *_RANGES["tm"])
    if mode not in _INTERVALS:
        return
    axis = fields.take_field("ta", *_RANGES["ta"])
    low, high = _INTERVALS[mode]
    interval = fields.take_field("tv", -high if mode in (2, 3) else low, high)
    if abs(interval) < low or (mode == 1 and axis != 1):
        raise CommandRefused


Program = dict[int, ProgramLine]
"""Lines by number; a missing line is NONE."""


class StoredPrograms:
    """The stored programs, the selected one (1-8), and the copy being edited."""

    def __init__(self) -> None:
        self._stored: list[Program] = [{1: _END} for _ in range(PROGRAMS)]
        self.selected = 1
        self._edited: Program = {}

    @property
    def current_program(self) -> Program:
        return self._stored[self.selected - 1]

    def power_down(self) -> None:
        self.selected = 1

    def begin_edit(self) -> None:
        """P:ON (L5642)."""
        self._edited = copy.copy(self.current_program)

    def save_edited(self) -> None:
        """P:OFF: append END if no line has one and line 4000 is free, and save (L5670)."""
        lines = self._edited
        if not any(line.pattern == "END" for line in lines.values()):
            last = max(lines, default=0)
            if last < LINES:
                lines[last + 1] = _END
        self._stored[self.selected - 1] = lines
        self._edited = {}

    def put_line(self, number: int, line: ProgramLine) -> None:
        if line.pattern == "NONE":
            self._edited.pop(number, None)
        else:
            self._edited[number] = line

    def get_line(self, number: int) -> ProgramLine:
        return self._edited.get(number, NONE)

    def clear_lines(self) -> None:
        """P:INIT: every line NONE (L7299)."""
        self._edited.clear()
