"""Program threads: position and subroutine stack of each (L14361-L14423, L14633)."""

from dataclasses import dataclass, field
from operator import attrgetter

from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.motion.trippoints import TripPoint

STACK = 16
NO_BREAK = -2147483648
"""Value of `_BK` without a breakpoint."""


@dataclass(slots=True)
class StackFrame:
    """Return position after a subroutine. `event` names the automatic routine that interrupted, if any."""

    line: int
    index: int
    trip: TripPoint | None = None
    event: str = ""


_NUMBER = attrgetter("number")


@dataclass(slots=True, eq=False)
class ProgramThread:
    """Thread `number`; `line` and `index` are those of the next statement. started: the threads of its controller that
    run, in the order of their numbers; each event looks at these only. A thread that does not run waits for nothing."""

    number: int
    started: "list[ProgramThread]"
    running: bool = False
    line: int = 0
    index: int = 0
    trip: TripPoint | None = None
    stack: list[StackFrame] = field(default_factory=list[StackFrame])
    paused: bool = False
    passed_break: bool = False
    steps: int = 0
    """Lines that `SL` still allows to run."""
    reference: int = 0
    """Sample that AT counts from."""
    spins: int = 0
    spin_sample: int = -1
    resting: bool = False
    """Blocked only because it loops without waiting."""
    input_for: str = ""
    """The variable that IN waits for."""
    input_port: str = "S"
    input_length: int = 0
    """Characters of a string that IN takes; 0 for a number."""

    @property
    def is_ready(self) -> bool:
        return self.running and self.trip is None and not self.paused

    def start_at(self, line: int, index: int, now: int) -> None:
        if not self.running:
            self.started.append(self)
            self.started.sort(key=_NUMBER)
        self.running, self.paused = True, False
        self.line, self.index, self.trip = line, index, None
        self.stack.clear()
        self.reference = now
        self.steps = 0

    def halt_thread(self) -> None:
        if self.running:
            self.started.remove(self)
        self.running = self.paused = False
        self.trip = None
        self.stack.clear()
        self.input_for = ""

    def call_subroutine(self, line: int, index: int = 0, event: str = "") -> None:
        """Jump to a subroutine; 12 when the stack is full."""
        if len(self.stack) >= STACK:
            raise CommandError(12)
        self.stack.append(StackFrame(self.line, self.index, self.trip, event))
        self.line, self.index, self.trip = line, index, None

    def leave_subroutine(self, *, restore: bool = False) -> str:
        """Return from a subroutine, with the interrupted trippoint or without; return the name of its event."""
        frame = self.stack.pop()
        self.line, self.index = frame.line, frame.index
        self.trip = frame.trip if restore else None
        return frame.event
