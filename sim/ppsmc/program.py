"""Program memory: program lines as they were sent, and what they mean (section 13)."""

import re
from dataclasses import dataclass, field
from fractions import Fraction

from sim.ppsmc.grammar import Refused, decimal, integer, nothing, split_name

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
class Position:
    """A positioning command (L3276-L3318). Speeds in Hz, ramps in Hz/ms; without `run_hz` at `start_hz` alone."""

    axis: int
    absolute: bool
    distance: Fraction
    start_hz: float
    run_hz: float | None = None
    acceleration: float = 0.0
    deceleration: float = 0.0


@dataclass(frozen=True, slots=True)
class Port:
    """An i/o part job: `out` byte, `set`/`res` bit, `in` of all bits or one, waiting for `level` if that is given."""

    name: str
    number: int | None = None
    level: bool | None = None


@dataclass(slots=True)
class Line:
    """One program line: its part jobs by their fixed order (L3216-L3222), and the commands as they were sent."""

    number: int | None = None
    text: list[str] = field(default_factory=list[str])
    messages: list[str] = field(default_factory=list[str])
    ports: list[Port] = field(default_factory=list[Port])
    filter: int | None = None
    screen: int | None = None
    positions: list[Position] = field(default_factory=list[Position])
    count_s: Fraction | None = None
    counting: bool | None = None
    """cntc begins, cnts ends a count over several lines."""
    delay_s: Fraction | None = None
    jump: int | None = None
    subroutine: tuple[int, int] | None = None
    """Line number and repetitions of a gosub."""
    returns: bool = False
    ends: bool = False


def read_position(text: str, axes: int) -> Position:
    """A positioning command. Raises `Refused`."""
    match = _POSITION.fullmatch(text.replace(" ", ""))
    if match is None:
        raise Refused("not a positioning command")
    axis = integer(match[1], 1, axes)
    start, run, up, down = (None if part is None else float(part) for part in match.groups()[3:])
    assert start is not None
    for speed in (start, run):
        if speed is not None and not 1 <= speed <= _MOST_HZ:
            raise Refused("speed out of range")
    if run is None or up is None:
        return Position(axis, match[2].lower() == "a", decimal(match[3]), start)
    down = up if down is None else down
    if not (1 <= up <= 1000 and 1 <= down <= 1000):
        raise Refused("ramp out of range")
    return Position(axis, match[2].lower() == "a", decimal(match[3]), start, run, up, down)


def _interval(text: str) -> Fraction:
    """0.1-600 s."""
    value = decimal(text)
    if not Fraction(1, 10) <= value <= 600:
        raise Refused("interval out of range")
    return value


class Memory:
    """The program memory: closed lines, and the one that is being written."""

    def __init__(self, axes: int, comma: str) -> None:
        self._axes = axes
        self._comma = comma
        self.lines: list[Line] = []
        self._open = Line()

    def clear(self) -> None:
        self.lines = []
        self._open = Line()

    @property
    def listing(self) -> list[str]:
        """Every command as it was sent, in order."""
        return [text for line in (*self.lines, self._open) for text in line.text]

    def load(self, listing: list[str]) -> None:
        """Replace the program."""
        self.clear()
        for text in listing:
            self.add(text)

    def index(self, number: int) -> int | None:
        """Where the line with `number` is; lines without a number follow on the one before, from 1."""
        current = 0
        for index, line in enumerate(self.lines):
            current = current + 1 if line.number is None else line.number
            if current == number:
                return index
        return None

    def number(self, index: int) -> int:
        """The number of the line at `index`."""
        current = 0
        for line in self.lines[: index + 1]:
            current = current + 1 if line.number is None else line.number
        return current

    def add(self, command: str) -> None:
        """Store a program command. Raises `Refused`, and then nothing is stored."""
        command = command.strip()
        text = command.rstrip(";").strip()
        line = self._open
        if text[:1].isdigit():
            line.positions.append(read_position(text, self._axes))
            line.text.append(command)
            return
        name, rest = split_name(text)
        name = NAMES[name]
        if name == "lin":
            number = integer(rest, 0, _MOST_LINE)
            if line.text and (line.number is None or len(line.text) > 1):
                # Part jobs without nl before it: that line is over.
                self._close()
                line = self._open
            line.number = number
        elif name == "nl":
            nothing(rest)
            if line.text:
                line.text.append(command)
                self._close()
            return
        else:
            self._part(line, name, rest)
        line.text.append(command)
        if name in ("end", "ret"):
            self._close()

    def _close(self) -> None:
        self.lines.append(self._open)
        self._open = Line()

    def _part(self, line: Line, name: str, rest: str) -> None:
        match name:
            case "msg":
                if not rest.startswith(":"):
                    raise Refused("':' missing")
                line.messages.append(rest[1:].translate(_MESSAGE).replace(",", self._comma))
            case "out":
                line.ports.append(Port(name, integer(rest, 0, 255)))
            case "set" | "res":
                line.ports.append(Port(name, integer(rest, 0, 7)))
            case "in":
                line.ports.append(_read_in(rest))
            case "fi":
                line.filter = integer(rest, 1, 6)
            case "hs":
                line.screen = integer(rest, 0, 4)
            case "cnt":
                line.count_s = _interval(rest)
            case "cntc" | "cnts":
                nothing(rest)
                line.counting = name == "cntc"
            case "delay":
                line.delay_s = _interval(rest)
            case "jump":
                line.jump = integer(rest, 0, _MOST_LINE)
            case "gosub":
                number, _, times = rest.partition("*")
                line.subroutine = (integer(number, 0, _MOST_LINE), integer(times, 1, _MOST_LINE) if times else 1)
            case _:
                nothing(rest)
                line.returns = line.returns or name == "ret"
                line.ends = line.ends or name == "end"


def _read_in(rest: str) -> Port:
    if not rest:
        return Port("in")
    match = _BIT.fullmatch(rest)
    if match is None:
        raise Refused("not a bit of the input port")
    return Port("in", int(match[1]), None if match[2] is None else match[2] == "1")
