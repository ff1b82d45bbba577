"""Program interpreter: sequence of lines and flow control (L2398-L2839, L3188-L3263)."""

from collections.abc import Callable
from dataclasses import dataclass

from sim.smc30.actions import StatementExecutor
from sim.smc30.expressions import OperandValues
from sim.smc30.motor import Activity
from sim.smc30.operands import PredefinedRegister
from sim.smc30.refusal import Code, StatementRefused
from sim.smc30.statements import (
    AssignRegister,
    CallSubroutine,
    Decision,
    IfComparison,
    InputContact,
    JumpLevel,
    JumpPattern,
    JumpThreshold,
    JumpToLine,
    LoopSegment,
    ReadInput,
    RepeatUntil,
    ReturnFromCall,
    Statement,
    StoredLine,
    WaitFor,
)
from sim.smc30.tempo import PausableTimer

_DEPTH = 32  # nested subroutines (L2815)
_BURST = 256
_BURST_NS = 10_000_000
"""An interpreter without a time per line executes this many lines at one instant and then pauses for this time, so that
an endless loop cannot stop the clock."""


@dataclass(slots=True)
class _ActiveLoop:
    """A loop in progress: its start line, the line of its Ln once known, and passes left."""

    start: int
    end: int | None = None
    left: int = 0


@dataclass(frozen=True, slots=True)
class _ProgramLap:
    """A jump back, and its instant."""

    source: int
    target: int
    generation: int
    at_ns: int


class ProgramInterpreter:
    """Runs the lines of the working memory. `stopped` is called at the end, with the error if there was one."""

    def __init__(
        self,
        tempo: PausableTimer,
        line_ns: int,
        values: OperandValues,
        actions: StatementExecutor,
        stopped: Callable[[Code | None], None],
    ) -> None:
        self._time = tempo.time
        self._tempo = tempo
        self._line_ns = line_ns
        self._values = values
        self._actions = actions
        self._stopped = stopped
        values.loops_left = self._loops_left
        self.running = False
        self._lines: list[StoredLine] = []
        self._at = 0
        self._returns: list[int] = []
        self._repeats: list[_ActiveLoop] = []
        self._awaited: InputContact | None = None
        self._lap: _ProgramLap | None = None
        self._path: list[int] = []
        """Lines executed since the last jump back, while all of them were decisions."""
        self._parked: list[int] = []
        """Lines of a lap whose result only an input can change; the program sleeps in it."""
        self._burst = 0

    def start_program(self, lines: list[StoredLine]) -> None:
        """Run from line 0."""
        self.abort_program()
        self._lines, self._at, self.running = lines, 0, True
        self._advance_line()

    def abort_program(self) -> None:
        self.running = False
        self._returns.clear()
        self._repeats.clear()
        self._awaited = None
        self._lap = None
        self._path = []
        self._parked = []
        self._burst = 0

    def inputs_changed(self) -> None:
        """Evaluate the inputs that W and polling loops wait for."""
        if not self.running or self._tempo.halted:
            return
        if self._awaited is not None and self._values.inputs.is_closed(self._awaited):
            self._awaited = None
            self._advance_line()
        elif self._parked and self._lap is not None:
            self._resume_lap(self._parked, self._lap)

    def _resume_lap(self, path: list[int], lap: _ProgramLap) -> None:
        """Resume after a parked lap: identical laps have continued meanwhile, so continue with the line that is next in
        the present lap."""
        self._parked, self._path, self._lap = [], [], None
        index, within_ns = 0, 0
        if self._line_ns:
            into_ns = (self._time.now_ns() - lap.at_ns) % (len(path) * self._line_ns)
            index, within_ns = divmod(into_ns, self._line_ns)
        self._at = path[index]
        self._tempo.call_after(self._line_ns - within_ns, self._line_due)

    # Lines

    def _advance_line(self) -> None:
        """Continue with the next line."""
        while True:
            if not self.running:
                return
            if self._at >= len(self._lines):
                self._end_program(None)
                return
            if self._line_ns:
                self._tempo.call_after(self._line_ns, self._line_due)
                return
            self._burst += 1
            if self._burst > _BURST:
                self._burst = 0
                self._tempo.call_after(_BURST_NS, self._advance_line)
                return
            if self._tempo.halted:
                self._tempo.call_after(0, self._advance_line)
                return
            if not self._perform_line():
                return

    def _line_due(self) -> None:
        if self._perform_line():
            self._advance_line()

    def _end_program(self, code: Code | None) -> None:
        self.abort_program()
        self._stopped(code)

    def _perform_line(self) -> bool:
        """Execute the line; return whether the next one can follow at once."""
        index = self._at
        self._at += 1
        if self._lap is not None:
            self._path.append(index)
        statement = self._lines[index].statement
        try:
            activity = self._execute_flow(index, statement)
        except StatementRefused as refusal:
            self._end_program(refusal.code)
            return False
        if activity is not None:
            return self._begin_activity(activity)
        return self._awaited is None and not self._parked

    def _begin_activity(self, activity: Activity) -> bool:
        """Begin an activity that takes time; return whether it finished at once."""
        over = beginning = False

        def finish_activity() -> None:
            nonlocal over
            over = True
            if not beginning:
                self._burst = 0
                self._advance_line()

        beginning = True
        activity(finish_activity)
        beginning = False
        return over and self.running

    # Flow

    def _execute_flow(self, index: int, statement: Statement) -> Activity | None:
        if isinstance(statement, Decision):
            self._decide_next(index, statement)
            return None
        self._break_lap()
        match statement:
            case CallSubroutine(line):
                self._call_subroutine(line)
            case ReturnFromCall():
                self._return_from_call()
            case LoopSegment(count):
                self._run_loop(index, count)
            case AssignRegister(PredefinedRegister("L")):
                self._run_loop(index, self._values.assigned_value(statement))
            case ReadInput(PredefinedRegister("L")):
                raise StatementRefused("E4")
            case _:
                return self._actions.execute_statement(statement)
        return None

    def _decide_next(self, index: int, statement: Decision) -> None:
        """Execute a statement that only chooses the next line."""
        inputs = self._values.inputs
        match statement:
            case JumpToLine(line):
                self._jump_to(index, line)
            case JumpPattern(pattern, line):
                self._jump_if(condition=inputs.user_pattern() == pattern, index=index, line=line)
            case JumpLevel(contact, level, line):
                self._jump_if(condition=inputs.is_closed(contact) == level, index=index, line=line)
            case JumpThreshold(threshold, line):
                self._jump_if(condition=inputs.is_beyond(threshold), index=index, line=line)
            case IfComparison():
                self._at += 0 if self._values.is_true(statement) else 1
                self._at = min(self._at, len(self._lines))
            case RepeatUntil(contact):
                self._jump_if(condition=inputs.is_closed(contact), index=index, line=self._until_start(index))
            case WaitFor(contact):
                if not inputs.is_closed(contact):
                    self._awaited = contact

    def _break_lap(self) -> None:
        """Break lap detection: a statement other than a decision makes the laps before and after it different."""
        self._lap = None
        self._path = []

    def _jump_if(self, index: int, line: int, *, condition: bool) -> None:
        if condition:
            self._jump_to(index, line)

    def _jump_to(self, index: int, line: int) -> None:
        if line > len(self._lines):
            # A label may be on the end, directly after the last line; a jump beyond it is an error (decision 26).
            raise StatementRefused("E4")
        self._at = line
        if line > index:
            return
        now_ns, generation = self._time.now_ns(), self._values.inputs.generation
        last = self._lap
        self._lap = _ProgramLap(index, line, generation, now_ns)
        path, self._path = self._path, []
        if last is not None and (last.source, last.target, last.generation) == (index, line, generation):
            self._parked = path

    def _until_start(self, index: int) -> int:
        """The line after the U before, or line 0 (decision 24)."""
        for at in range(index - 1, -1, -1):
            if isinstance(self._lines[at].statement, RepeatUntil):
                return at + 1
        return 0

    def _call_subroutine(self, line: int) -> None:
        if len(self._returns) >= _DEPTH or line >= len(self._lines):
            raise StatementRefused("E4")
        self._returns.append(self._at)
        self._at = line

    def _return_from_call(self) -> None:
        if not self._returns:
            raise StatementRefused("E4")
        self._at = self._returns.pop()

    def _run_loop(self, index: int, count: int) -> None:
        repeats = self._repeats
        if count == 0:
            # A loop left by a jump restarts, together with all loops inside it.
            for depth, repeat in enumerate(repeats):
                if repeat.start == index + 1:
                    del repeats[depth:]
                    break
            repeats.append(_ActiveLoop(index + 1))
            return
        if not repeats or repeats[-1].end not in (None, index):
            # Without L0 the loop is from the first line (decision 25).
            repeats.append(_ActiveLoop(0))
        repeat = repeats[-1]
        if repeat.end is None:
            repeat.end, repeat.left = index, count
        if repeat.left > 0:
            repeat.left -= 1
            self._at = repeat.start
        else:
            repeats.pop()

    def _loops_left(self) -> int:
        return self._repeats[-1].left if self._repeats else 0
