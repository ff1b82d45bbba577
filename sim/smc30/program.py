"""The program interpreter: lines one after another, and what leads from one to another (L2398-L2839, L3188-L3263)."""

from collections.abc import Callable
from dataclasses import dataclass

from sim.core.devicetime import DeviceTime
from sim.smc30.actions import Actions
from sim.smc30.expressions import Values
from sim.smc30.motor import Activity
from sim.smc30.operands import Predefined
from sim.smc30.refusal import Code, Refused
from sim.smc30.statements import (
    Assign,
    Call,
    Contact,
    If,
    Input,
    Jump,
    JumpLevel,
    JumpPattern,
    JumpThreshold,
    Line,
    Loop,
    Return,
    Statement,
    Until,
    WaitFor,
)
from sim.smc30.tempo import Tempo

_DEPTH = 32  # nested subroutines (L2815)
_BURST = 256
_BURST_NS = 10_000_000
"""An interpreter without a time per line makes so many lines at one instant and then this pause,
lest an endless loop stop the clock."""


@dataclass(slots=True)
class _Repeat:
    """A loop that is being repeated: where it goes back to, its Ln once that is known, and passes left."""

    start: int
    end: int | None = None
    left: int = 0


@dataclass(frozen=True, slots=True)
class _Lap:
    """A jump back, and when it was made."""

    source: int
    target: int
    generation: int
    at_ns: int


class Program:
    """Runs the lines of the working memory. `stopped` hears of the end, with the error if there was one."""

    def __init__(
        self,
        time: DeviceTime,
        tempo: Tempo,
        line_ns: int,
        values: Values,
        actions: Actions,
        stopped: Callable[[Code | None], None],
    ) -> None:
        self._time = time
        self._tempo = tempo
        self._line_ns = line_ns
        self._values = values
        self._actions = actions
        self._stopped = stopped
        values.loops_left = self._loops_left
        self.running = False
        self._lines: list[Line] = []
        self._at = 0
        self._returns: list[int] = []
        self._repeats: list[_Repeat] = []
        self._awaited: Contact | None = None
        self._lap: _Lap | None = None
        self._path: list[int] = []
        """Lines executed since the last jump back, as long as they were decisions."""
        self._parked: list[int] = []
        """Lines of a lap whose course only an input can change; the program sleeps in it."""
        self._burst = 0

    def start(self, lines: list[Line]) -> None:
        """Run from line 0."""
        self.abort()
        self._lines, self._at, self.running = lines, 0, True
        self._advance()

    def abort(self) -> None:
        self.running = False
        self._returns.clear()
        self._repeats.clear()
        self._awaited = None
        self._lap = None
        self._path = []
        self._parked = []
        self._burst = 0

    def inputs_changed(self) -> None:
        """Look at what W and polling loops wait for."""
        if not self.running or self._tempo.halted:
            return
        if self._awaited is not None and self._values.inputs.closed(self._awaited):
            self._awaited = None
            self._advance()
        elif self._parked and self._lap is not None:
            self._unpark(self._parked, self._lap)

    def _unpark(self, path: list[int], lap: _Lap) -> None:
        """The same laps have gone on all the while: go on with the line that is next in this one."""
        self._parked, self._path, self._lap = [], [], None
        index, within_ns = 0, 0
        if self._line_ns:
            into_ns = (self._time.now_ns() - lap.at_ns) % (len(path) * self._line_ns)
            index, within_ns = divmod(into_ns, self._line_ns)
        self._at = path[index]
        self._tempo.after(self._line_ns - within_ns, self._line_due)

    # Lines

    def _advance(self) -> None:
        """Go on to the next line."""
        while True:
            if not self.running:
                return
            if self._at >= len(self._lines):
                self._end(None)
                return
            if self._line_ns:
                self._tempo.after(self._line_ns, self._line_due)
                return
            self._burst += 1
            if self._burst > _BURST:
                self._burst = 0
                self._tempo.after(_BURST_NS, self._advance)
                return
            if self._tempo.halted:
                self._tempo.after(0, self._advance)
                return
            if not self._perform():
                return

    def _line_due(self) -> None:
        if self._perform():
            self._advance()

    def _end(self, code: Code | None) -> None:
        self.abort()
        self._stopped(code)

    def _perform(self) -> bool:
        """Execute the line; whether the next one can follow at once."""
        here = self._at
        self._at += 1
        if self._lap is not None:
            self._path.append(here)
        statement = self._lines[here].statement
        try:
            activity = self._execute(here, statement)
        except Refused as refusal:
            self._end(refusal.code)
            return False
        if activity is not None:
            return self._live(activity)
        return self._awaited is None and not self._parked

    def _live(self, activity: Activity) -> bool:
        """Begin what takes time; whether it was over at once."""
        over = beginning = False

        def done() -> None:
            nonlocal over
            over = True
            if not beginning:
                self._burst = 0
                self._advance()

        beginning = True
        activity(done)
        beginning = False
        return over and self.running

    # Flow

    def _execute(self, here: int, statement: Statement) -> Activity | None:
        inputs = self._values.inputs
        match statement:
            case Jump(line):
                self._jump(here, line)
            case JumpPattern(pattern, line):
                self._jump_if(inputs.pattern() == pattern, here, line)
            case JumpLevel(contact, level, line):
                self._jump_if(inputs.closed(contact) == level, here, line)
            case JumpThreshold(threshold, line):
                self._jump_if(inputs.beyond(threshold), here, line)
            case If():
                self._at += 0 if self._values.holds(statement) else 1
                self._at = min(self._at, len(self._lines))
            case Until(contact):
                self._jump_if(inputs.closed(contact), here, self._until_start(here))
            case WaitFor(contact):
                if not inputs.closed(contact):
                    self._awaited = contact
            case Call(line):
                self._touch()
                self._call(line)
            case Return():
                self._touch()
                self._return()
            case Loop(count):
                self._touch()
                self._loop(here, count)
            case Assign(Predefined("L")):
                self._touch()
                self._loop(here, self._values.assigned(statement))
            case Input(Predefined("L")):
                raise Refused("E4")
            case _:
                self._touch()
                return self._actions.perform(statement)
        return None

    def _touch(self) -> None:
        """Something other than a decision was done: laps before and after it are not alike."""
        self._lap = None
        self._path = []

    def _jump_if(self, condition: bool, here: int, line: int) -> None:
        if condition:
            self._jump(here, line)

    def _jump(self, here: int, line: int) -> None:
        if line > len(self._lines):
            # The line after the last one is the end, where a label there leads; beyond it is an error (decision 26).
            raise Refused("E4")
        self._at = line
        if line > here:
            return
        now_ns, generation = self._time.now_ns(), self._values.inputs.generation
        last = self._lap
        self._lap = _Lap(here, line, generation, now_ns)
        path, self._path = self._path, []
        if last is not None and (last.source, last.target, last.generation) == (here, line, generation):
            self._parked = path

    def _until_start(self, here: int) -> int:
        """The line after the U before, or line 0 (decision 24)."""
        for at in range(here - 1, -1, -1):
            if isinstance(self._lines[at].statement, Until):
                return at + 1
        return 0

    def _call(self, line: int) -> None:
        if len(self._returns) >= _DEPTH or line >= len(self._lines):
            raise Refused("E4")
        self._returns.append(self._at)
        self._at = line

    def _return(self) -> None:
        if not self._returns:
            raise Refused("E4")
        self._at = self._returns.pop()

    def _loop(self, here: int, count: int) -> None:
        repeats = self._repeats
        if count == 0:
            # A loop left by a jump is begun anew, with all that was inside it.
            for depth, repeat in enumerate(repeats):
                if repeat.start == here + 1:
                    del repeats[depth:]
                    break
            repeats.append(_Repeat(here + 1))
            return
        if not repeats or repeats[-1].end not in (None, here):
            # Without L0 the loop is from the first line (decision 25).
            repeats.append(_Repeat(0))
        repeat = repeats[-1]
        if repeat.end is None:
            repeat.end, repeat.left = here, count
        if repeat.left > 0:
            repeat.left -= 1
            self._at = repeat.start
        else:
            repeats.pop()

    def _loops_left(self) -> int:
        return self._repeats[-1].left if self._repeats else 0
