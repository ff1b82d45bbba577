"""Program threads: where each one is, and its subroutine stack (L14361-L14423, L14633)."""

from dataclasses import dataclass, field

from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.motion.trippoints import Trip

STACK = 16


@dataclass(slots=True)
class Frame:
    """Where to go on after a subroutine. `event` names the automatic routine that interrupted, if any."""

    line: int
    index: int
    trip: Trip | None = None
    event: str = ""


@dataclass(slots=True)
class Thread:
    """Thread `number`; `line` and `index` are of the statement to come."""

    number: int
    running: bool = False
    line: int = 0
    index: int = 0
    trip: Trip | None = None
    stack: list[Frame] = field(default_factory=list[Frame])
    paused: bool = False
    passed_break: bool = False
    steps: int = 0
    """Lines that `SL` still lets run."""
    reference: int = 0
    """Sample that AT counts from."""
    spins: int = 0
    spin_sample: int = -1
    resting: bool = False
    """Held only because it loops without waiting."""
    input_for: str = ""
    """The variable that IN waits for."""
    input_port: str = "S"
    input_length: int = 0
    """Characters of a string that IN takes; 0 for a number."""

    @property
    def ready(self) -> bool:
        return self.running and self.trip is None and not self.paused

    def start(self, line: int, index: int, now: int) -> None:
        self.running, self.paused = True, False
        self.line, self.index, self.trip = line, index, None
        self.stack.clear()
        self.reference = now
        self.steps = 0

    def halt(self) -> None:
        self.running = self.paused = False
        self.trip = None
        self.stack.clear()
        self.input_for = ""

    def call(self, line: int, index: int = 0, event: str = "") -> None:
        """Jump to a subroutine; 12 when the stack is full."""
        if len(self.stack) >= STACK:
            raise CommandError(12)
        self.stack.append(Frame(self.line, self.index, self.trip, event))
        self.line, self.index, self.trip = line, index, None

    def leave(self, restore: bool = False) -> str:
        """Go back to where the subroutine was called, with the interrupted trippoint or without; names its event."""
        frame = self.stack.pop()
        self.line, self.index = frame.line, frame.index
        self.trip = frame.trip if restore else None
        return frame.event
