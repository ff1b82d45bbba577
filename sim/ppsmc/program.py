"""Program memory: program lines as they were sent, and their parsed form (section 13)."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction

from sim.ppsmc.grammar import InputRefused, parse_decimal, parse_integer, require_end, split_name

_POSITION = re.compile(
    r"(\d{1,2})\s*:\s*([ar]?)([+-]?(?:\d+\.?\d*|\.\d+))s(\d+(?:\.\d*)?)"
    r"(?:r(\d+(?:\.\d*)?)a(\d+(?:\.\d*)?)(?:d(\d+(?:\.\d*)?))?)?",
    re.IGNORECASE,
)
_BIT = re.compile(r"([0-7])(?:\.([01]))?")
_MOST_LINE = 2**31 - 1
_MOST_HZ = 2_457_000
_MESSAGE = str.maketrans("", "", "\t ;")

NEEDS = {
    "cnt": "counter",
    "cntc": "counter",
    "cnts": "counter",
    "fi": "filter",
    "hs": "half_screen",
    "in": "io_port",
    "out": "io_port",
    "set": "io_port",
    "res": "io_port",
}
"""Hardware that program commands need."""

NAMES = {
    "cnt": "cnt",
    "cntc": "cntc",
    "cnts": "cnts",
    "delay": "delay",
    "end": "end",
    "fi": "fi",
    "gosub": "gosub",
    "gsb": "gosub",
    "hs": "hs",
    "in": "in",
    "jump": "jump",
    "jmp": "jump",
    "lin": "lin",
    "msg": "msg",
    "nl": "nl",
    "out": "out",
    "res": "res",
    "ret": "ret",
    "set": "set",
}
"""Program commands by all their names (L3256-L3273)."""


@dataclass(frozen=True, slots=True)
class PositioningCommand:
    """A positioning command (L3276-L3318). Speeds in Hz, ramps in Hz/ms; without `run_hz` at `start_hz` alone."""

    axis: int
    absolute: bool
    distance: Fraction
    start_hz: float
    run_hz: float | None = None
    acceleration: float = 0.0
    deceleration: float = 0.0


@dataclass(frozen=True, slots=True)
class PortJob:
    """An i/o part job: `out` byte, `set`/`res` bit, `in` of all bits or one, waiting for `level` if that is given."""

    name: str
    number: int | None = None
    level: bool | None = None


@dataclass(slots=True)
class JobLine:
    """One program line: its part jobs by their fixed order (L3216-L3222), and the commands as they were sent."""

    number: int | None = None
    text: list[str] = field(default_factory=list[str])
    messages: list[str] = field(default_factory=list[str])
    ports: list[PortJob] = field(default_factory=list[PortJob])
    filter: int | None = None
    screen: int | None = None
    positions: list[PositioningCommand] = field(default_factory=list[PositioningCommand])
    count_s: Fraction | None = None
    counting: bool | None = None
    """cntc begins, cnts ends a count over several lines."""
    delay_s: Fraction | None = None
    jump: int | None = None
    subroutine: tuple[int, int] | None = None
    """Line number and repetitions of a gosub."""
    returns: bool = False
    ends: bool = False


def read_position(text: str, axes: int) -> PositioningCommand:
    """Parse a positioning command. Raises `InputRefused`."""
    match = _POSITION.fullmatch(text.replace(" ", ""))
    if match is None:
        raise InputRefused("not a positioning command")
    axis = parse_integer(match[1], 1, axes)
    start, run, up, down = (None if part is None else float(part) for part in match.groups()[3:])
    assert start is not None
    for speed in (start, run):
        if speed is not None and not 1 <= speed <= _MOST_HZ:
            raise InputRefused("speed out of range")
    if run is None or up is None:
        return PositioningCommand(axis, match[2].lower() == "a", parse_decimal(match[3]), start)
    down = up if down is None else down
    if not (1 <= up <= 1000 and 1 <= down <= 1000):
        raise InputRefused("ramp out of range")
    return PositioningCommand(
        axis=axis,
        absolute=match[2].lower() == "a",
        distance=parse_decimal(match[3]),
        start_hz=start,
        run_hz=run,
        acceleration=up,
        deceleration=down,
    )


def _parse_interval(text: str) -> Fraction:
    """0.1-600 s."""
    value = parse_decimal(text)
    if not Fraction(1, 10) <= value <= 600:
        raise InputRefused("interval out of range")
    return value


PartParser = Callable[[JobLine, str], None]
"""Adds a part job to a line, from the text after its name."""


class ProgramMemory:
    """The program memory: closed lines, and the line being written."""

    def __init__(self, axes: int, comma: str) -> None:
        self._axes = axes
        self._comma = comma
        self.lines: list[JobLine] = []
        self._open = JobLine()

    def clear_program(self) -> None:
        self.lines = []
        self._open = JobLine()

    @property
    def list_commands(self) -> list[str]:
        """Return every command as it was sent, in order."""
        return [text for line in (*self.lines, self._open) for text in line.text]

    def load_listing(self, listing: list[str]) -> None:
        """Replace the program."""
        self.clear_program()
        for text in listing:
            self.add_command(text)

    def find_index(self, number: int) -> int | None:
        """Return the index of the line with `number`; lines without a number count on from the one before, from 1."""
        current = 0
        for index, line in enumerate(self.lines):
            current = current + 1 if line.number is None else line.number
            if current == number:
                return index
        return None

    def line_number(self, index: int) -> int:
        """Return the number of the line at `index`."""
        current = 0
        for line in self.lines[: index + 1]:
            current = current + 1 if line.number is None else line.number
        return current

    def add_command(self, command: str) -> None:
        """Store a program command. Raises `InputRefused`, and then nothing is stored."""
        command = command.strip()
        text = command.rstrip(";").strip()
        line = self._open
        if text[:1].isdigit():
            line.positions.append(read_position(text, self._axes))
            line.text.append(command)
            return
        name, argument = split_name(text)
        name = NAMES[name]
        if name == "lin":
            number = parse_integer(argument, 0, _MOST_LINE)
            if line.text and (line.number is None or len(line.text) > 1):
                # A part job without nl before it: the open line is complete.
                self._close_line()
                line = self._open
            line.number = number
        elif name == "nl":
            require_end(argument)
            if line.text:
                line.text.append(command)
                self._close_line()
            return
        else:
            self._add_part(line, name, argument)
        line.text.append(command)
        if name in ("end", "ret"):
            self._close_line()

    def _add_part(self, line: JobLine, name: str, rest: str) -> None:
        if name == "msg":
            if not rest.startswith(":"):
                raise InputRefused("':' missing")
            line.messages.append(rest[1:].translate(_MESSAGE).replace(",", self._comma))
        else:
            _PARTS[name](line, rest)

    def _close_line(self) -> None:
        self.lines.append(self._open)
        self._open = JobLine()


def _parse_in(rest: str) -> PortJob:
    if not rest:
        return PortJob("in")
    match = _BIT.fullmatch(rest)
    if match is None:
        raise InputRefused("not a bit of the input port")
    return PortJob("in", int(match[1]), None if match[2] is None else match[2] == "1")


def _add_port(name: str, largest: int) -> PartParser:
    def add_job(line: JobLine, rest: str) -> None:
        line.ports.append(PortJob(name, parse_integer(rest, 0, largest)))

    return add_job


def _add_input(line: JobLine, rest: str) -> None:
    line.ports.append(_parse_in(rest))


def _set_filter(line: JobLine, rest: str) -> None:
    line.filter = parse_integer(rest, 1, 6)


def _set_screen(line: JobLine, rest: str) -> None:
    line.screen = parse_integer(rest, 0, 4)


def _set_count(line: JobLine, rest: str) -> None:
    line.count_s = _parse_interval(rest)


def _start_counting(line: JobLine, rest: str) -> None:
    require_end(rest)
    line.counting = True


def _stop_counting(line: JobLine, rest: str) -> None:
    require_end(rest)
    line.counting = False


def _set_delay(line: JobLine, rest: str) -> None:
    line.delay_s = _parse_interval(rest)


def _set_jump(line: JobLine, rest: str) -> None:
    line.jump = parse_integer(rest, 0, _MOST_LINE)


def _set_subroutine(line: JobLine, rest: str) -> None:
    number, _, times = rest.partition("*")
    line.subroutine = (parse_integer(number, 0, _MOST_LINE), parse_integer(times, 1, _MOST_LINE) if times else 1)


def _set_return(line: JobLine, rest: str) -> None:
    require_end(rest)
    line.returns = True


def _set_end(line: JobLine, rest: str) -> None:
    require_end(rest)
    line.ends = True


_PARTS: dict[str, PartParser] = {
    "out": _add_port("out", 255),
    "set": _add_port("set", 7),
    "res": _add_port("res", 7),
    "in": _add_input,
    "fi": _set_filter,
    "hs": _set_screen,
    "cnt": _set_count,
    "cntc": _start_counting,
    "cnts": _stop_counting,
    "delay": _set_delay,
    "jump": _set_jump,
    "gosub": _set_subroutine,
    "ret": _set_return,
    "end": _set_end,
}
"""Part jobs of a line by their names; `msg` is apart, because the option of the comma changes it."""
