"""The language of a controller with text lines: what a make states about it.

Positions in a dialect are numbers in the controller's own unit; the driver converts them from and to counts.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

from adapters.contract import ControllerIdentity

LineState = Literal["idle", "moving", "held", "alarm"]
"""held: a motion is interrupted, or one is loaded and waits; nothing moves."""

LineMeaning = Literal["reply", "restarted", "ignored"]
"""What a line means that the controller sends: it belongs to a command; the controller has restarted; neither."""


@dataclass(frozen=True, slots=True)
class LineAxisStatus:
    """An axis as the controller reports it. position: in the controller's unit."""

    position: float
    moving: bool = False
    limit: Literal["none", "forward", "reverse", "both"] = "none"


@dataclass(frozen=True, slots=True)
class LineStatus:
    """The controller as it reports itself. axes: by motor.

    is_loaded: whether a loaded move waits for its start; None where the controller does not report it.
    alarm: its own words for what is wrong.
    doubt: what it shows at rest, with nothing loaded, that the make does not expect of its controllers.
    """

    state: LineState
    axes: Mapping[str, LineAxisStatus]
    is_loaded: bool | None = None
    alarm: str = ""
    doubt: str = ""


@dataclass(frozen=True, slots=True)
class LineStep:
    """One step of a procedure: bytes that are written, and how its end is recognised.

    is_done: recognises the last line of the reply; None: the controller does not reply.
    until: then the status is read until it is one of these. timeout_s: of reply and status; None: the usual one.
    expected: what is expected, for messages.
    """

    data: bytes = b""
    is_done: Callable[[str], bool] | None = None
    until: tuple[LineState, ...] = ()
    timeout_s: float | None = None
    expected: str = ""


@dataclass(frozen=True, slots=True)
class LineTarget:
    """One axis of a move, in the controller's unit: absolute target, distance (signed), per second, per second²."""

    motor: str
    position: float
    distance: float
    velocity: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class LineSetting:
    """A stored setting that must have a certain value, or at least it. step: reads it. read: finds the value in a line
    of the reply; None where the line has none. item: what it is, for messages."""

    item: str
    step: LineStep
    read: Callable[[str], float | None]
    expected: float
    remedy: str
    is_minimum: bool = False


@dataclass(frozen=True, slots=True)
class LineTraits:
    """How the controller behaves.

    joint: all axes of a move share one profile along a straight line, and start and end together; they cannot be
    jogged at the same time, and are homed together.
    fixed_acceleration: the acceleration is a stored setting of the controller, that of the fleet file's limits.
    armed_state: its state while a move is loaded. start_confirmed: the reply to the start is sent after the start.
    answers_while_homing: it reports its status while it searches.
    keeps_session: a stop does not clear the session number.
    session_place: where a file states the session number, for messages.
    """

    joint: bool = False
    fixed_acceleration: bool = False
    armed_state: LineState = "idle"
    start_confirmed: bool = True
    answers_while_homing: bool = True
    keeps_session: bool = True
    switches_motors: bool = False
    terminators: tuple[str, ...] = field(default=("\n",))
    session_place: str = ""


class LineDialect(Protocol):
    """The language of one make. Methods return what is to be written; they do not write."""

    @property
    def traits(self) -> LineTraits: ...

    @property
    def spoiler(self) -> bytes:
        """Bytes that end a half-typed line, and do nothing else."""
        ...

    @property
    def stop_bytes(self) -> bytes:
        """Bytes that stop every motion by its ramp, at any moment, without waiting for a reply. Idempotent."""
        ...

    @property
    def stop_search_bytes(self) -> bytes:
        """Bytes that end a search for the reference."""
        ...

    def classify_line(self, line: str) -> LineMeaning: ...

    def find_refusal(self, line: str) -> str:
        """Return the controller's words when the line refuses a command, otherwise an empty text."""
        ...

    def ask_identity(self) -> LineStep: ...

    def read_identity(self, lines: Sequence[str]) -> ControllerIdentity | None:
        """Return the identity; None if the lines do not contain that of this make."""
        ...

    def ask_status(self) -> LineStep: ...

    def read_status(self, lines: Sequence[str]) -> LineStatus | None: ...

    def ask_session(self) -> LineStep:
        """Ask for the session number: a volatile value, 0 after power-up, by which a restart is noticed."""
        ...

    def read_session(self, lines: Sequence[str]) -> int | None: ...

    def write_session(self, number: int) -> Sequence[LineStep]:
        """Set the session number, 1 to 99."""
        ...

    def settings(self) -> Sequence[LineSetting]:
        """Return the stored settings that must match the fleet file."""
        ...

    def load_move(self, targets: Sequence[LineTarget]) -> Sequence[LineStep]:
        """Load a move without starting it."""
        ...

    def start_move(self) -> LineStep:
        """Start the loaded move. Without one nothing moves."""
        ...

    def finish_stop(self) -> Sequence[LineStep]:
        """Bring a controller that was stopped, or in which a move is loaded, to rest with nothing loaded."""
        ...

    def search_reference(self, motors: Sequence[str], timeout_s: float) -> Sequence[LineStep]: ...

    def begin_jog(self, target: LineTarget) -> Sequence[LineStep]: ...

    def stop_jog(self, motor: str) -> bytes: ...

    def switch_motors(self, motors: Sequence[str], *, on: bool) -> Sequence[LineStep]:
        """Switch motors, where the controller can (`traits.switches_motors`)."""
        ...

    def clear_alarm(self) -> Sequence[LineStep]: ...
