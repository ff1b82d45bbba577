"""Differences between the models of the family."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

from sim.yaskawa.base.data import MemoryCapacity
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.formats import NumberFormat
from sim.yaskawa.language.expressions import Evaluator
from sim.yaskawa.language.parameters import AxisParameter
from sim.yaskawa.language.statements import CommandDefinition
from sim.yaskawa.ports.ports import PortSession

SYSTEM_OPS = frozenset(("VA", "VD", "VS", "VR", "VT", "AV"))
HANDLE_OPS = frozenset(("IH", "SA", "MB", "HS"))
AXIS_OPS = frozenset("AD AE AP AR CD DE DP EG EQ GA GM IP LI MF MR".split())  # noqa: SIM905
"""Further op-codes, apart from the parameters, that accept `XXa=value`.

Another op-code before a letter begins a name (L16820).
"""


@dataclass(frozen=True, slots=True)
class MotionFigures:
    """Motion figures that differ between models: speeds in counts/s, accelerations in counts/s^2, sizes in entries.

    fastest: of `<n` and `>m` after a segment.
    vector: VS, VA and VD after a master reset.
    home_speed: of the second and third stage of HM.
    cam_points: entries of the table of ET.
    contour_step: largest increment of CD.
    """

    fastest: tuple[int, int]
    vector: tuple[int, int, int]
    home_speed: int
    cam_points: int
    encoder_resolution: int = 100_000
    """Largest argument of AE, counts a revolution."""
    contour_step: int = 32767
    contour_stops_at_record: bool = False
    """ST lets the executing record end and leaves the contour mode there; otherwise it decelerates at once."""
    lag: int = 1
    """Samples from a command to its effect on the encoder reading, with an ideal motor."""
    cycles_by_turns: bool = False
    """A cam's axes are reported by the master's turns since EP's start, not each modulo its own cycle."""
    stepper_home_stages: int = 3
    """Stages of HM for a stepper motor."""
    stepper_fastest: int = 0
    """0: as a servo."""
    default_plane: bool = False
    """The coordinate system is in vector mode in X and Y by default (L11451; SMC-2000: L12450)."""
    virtual_axis: bool = False
    systems: str = "S"


@dataclass(frozen=True, slots=True)
class BurnTimes:
    """Durations of BN, BP and BV, seconds; and which of them are refused in motion.

    cam: BN keeps it too (L3257)."""

    seconds: dict[str, int]
    at_rest: frozenset[str] = frozenset()
    cam: bool = False


@dataclass(frozen=True, eq=False)
class ControllerModel:
    """Name and properties of one model.

    commands, operands: its op-codes.
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
    commands: dict[str, CommandDefinition]
    operands: dict[str, Callable[[str], Evaluator]]
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
    serial_port: type[PortSession] = PortSession
    second_port: type[PortSession] = PortSession
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

    @cached_property
    def _compiled_operands(self) -> dict[str, Evaluator]:
        return {}

    def compile_operand(self, text: str) -> Evaluator:
        """Return the function that reads `_XX…`; 58 when there is no such operand."""
        found = self._compiled_operands.get(text)
        if found is None:
            entry = self.operands.get(text[1:3])
            if entry is None:
                raise CommandError(58)
            found = self._compiled_operands[text] = entry(text[3:])
        return found

    def allowed_suffixes(self, op: str) -> str:
        """Return the letters that may follow `op` in `XXa=value` (axes in their X Y Z W names)."""
        if op in HANDLE_OPS:
            return "XYZWABCDEFGHST"
        if op not in self.parameters and op not in AXIS_OPS and op not in SYSTEM_OPS:
            return ""
        axes = self.letters + "N" if self.figures.virtual_axis else self.letters
        return axes + self.figures.systems if op in SYSTEM_OPS else axes
