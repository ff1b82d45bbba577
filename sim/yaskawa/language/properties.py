"""Differences between the models of the family."""

from collections.abc import Callable
from dataclasses import dataclass, field

from sim.yaskawa.base.data import MemoryCapacity
from sim.yaskawa.base.formats import NumberFormat
from sim.yaskawa.language.parameters import AxisParameter
from sim.yaskawa.motion.figures import MotionFigures


@dataclass(frozen=True, slots=True)
class BurnTimes:
    """Durations of BN, BP and BV, seconds; and which of them are refused in motion.

    cam: BN keeps it too (L3257)."""

    seconds: dict[str, int]
    at_rest: frozenset[str] = frozenset()
    cam: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelProperties:
    """Name and properties of one model, apart from its command tables.

    functions: its `@…`.
    texts: what `TC1` reports of each error code.
    ports: names, the default one first.
    letters: of all axes that it can have, by number.
    handles: of Ethernet.
    threads: their number.
    by_line: a thread yields after a line, not after a command.
    comments: the beginnings of a comment; comment_end: its end, empty for the end of the line.
    designators: it has `~a`.
    running_bit: of TB while a program runs.
    time_bases: for a number of axes the smallest and largest `TM` and its step, nominal microseconds.
    password: of LC after a master reset; locks: whether LC at a level forbids an op-code with its lock and its text.
    """

    name: str
    revision: str
    ports: tuple[str, ...]
    parameters: dict[str, AxisParameter]
    functions: frozenset[str]
    texts: dict[int, str]
    letters: str
    figures: MotionFigures
    room: MemoryCapacity
    threads: int
    time_bases: Callable[[int], tuple[int, int, int]]
    burning: BurnTimes
    locks: Callable[[int, str, str, str], bool]
    lock_levels: int
    password: str = ""
    handles: str = ""
    by_trigger_line: bool = True
    spaced_names: bool = True
    """Blanks inside a name are ignored."""
    comments: tuple[str, ...] = ("NO ",)
    comment_end: str = ""
    designators: bool = False
    running_bit: int = 7
    still_data: bool = True
    """QD and QU are refused in motion, and QD in programs."""
    switch_levels: bool = True
    """TS reports the levels of the limit switches; otherwise whether they are inactive."""
    factory_echo: bool = False
    """A master reset switches the echo on, whatever the option states."""
    external_clock: bool = False
    """A negative `TM` takes the samples of another controller."""
    speed_digits: int = 8
    """Digits of `TV`."""
    keywords: tuple[str, ...] = ("P1CD", "P1CH", "P1NM", "P1ST")
    """Names of the values received on serial ports."""
    burned: frozenset[str] = field(default_factory=frozenset[str])
    """Parameters of axes that BN keeps."""
    formats: dict[str, NumberFormat | None] = field(default_factory=dict[str, NumberFormat | None])
    """Formats of the answers to `XX ?` of commands that are not parameters of axes: a format, None for PF; VF when
    absent."""
    codes: dict[int, int] = field(default_factory=dict[int, int])
    """Replacements for codes of the family that this model does not have."""
    password_discards: bool = False
    """PW burns only itself: the parameters burned by BN are lost (L8450)."""
    still_encoders: bool = False
    """QY is refused in motion."""
    unasked: frozenset[str] = frozenset()
    """Commands for which `?` is refused, though others of the family take it."""
    proper_arrays: bool = False
    """Names of arrays begin with a capital."""
