"""Program execution: line after line, in each line the part jobs in their fixed order (L3216-L3222)."""

from collections.abc import Callable, Generator
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Timer
from sim.ppsmc.counter import Counter
from sim.ppsmc.grammar import Refused
from sim.ppsmc.machine import Machine
from sim.ppsmc.moves import positioning
from sim.ppsmc.path import Profile
from sim.ppsmc.program import Line, Memory, Port, Position
from sim.ppsmc.task import Kind

Say = Callable[[str], None]
_HOLD_LINES = 1000
"""Lines without any wait after which a program gives way for a moment: an endless loop must not stop time."""


@dataclass(slots=True)
class _Return:
    """A gosub that runs: the line after it, the subroutine's first line, and repetitions still to come."""

    to: int
    first: int
    left: int


Job = Generator[Callable[[Callable[[], None]], None], None, None]
"""Yields waits: each takes what is to be called when it is over."""


class Runner:
    """Runs the program in the memory. Waits are events; a program that waits for an input schedules nothing."""

    def __init__(self, machine: Machine, memory: Memory, counter: Counter) -> None:
        self._machine = machine
        self._memory = memory
        self._counter = counter
        self._job: Job | None = None
        self._timer: Timer | None = None
        self._waiting: tuple[Port, int, Callable[[], None]] | None = None
        self._only: int | None = None
        self._say: Say = _silent
        self._lines_run = 0
        self.line = 0
        """Number of the line that is executed; 0 without a program."""
        self.filter = 1
        self.screen = 0
        machine.on_input = self._input_changed

    @property
    def running(self) -> bool:
        return self._job is not None

    def start(self, first: int | None, only: int | None, repetitions: int, say: Say) -> None:
        """Run from line number `first` (None: the beginning), on axis `only` (None: all). Raises `Refused`.

        `say` takes messages and input states.
        """
        index = 0 if first is None else self._memory.index(first)
        if index is None:
            raise Refused(f"no program line {first}")
        if not self._memory.lines:
            raise Refused("no program")
        self._only, self._say = only, say
        self._job = self._program(index, repetitions)
        self._next()

    def abort(self) -> None:
        """End the program; motions are the machine's business."""
        if self._job is None:
            return
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        job, self._job, self._waiting, self.line = self._job, None, None, 0
        job.close()
        self._counter.cancel()

    def _next(self) -> None:
        """Go on until the next wait; waits that are over at once do not pile up on the stack."""
        self._timer = None
        while self._job is not None:
            job = self._job
            wait = next(job, None)
            if wait is None:
                self._job, self.line = None, 0
                return
            state = _Wait()

            def over(state: _Wait = state, job: Job = job) -> None:
                state.over = True
                if state.returned and self._job is job:
                    self._next()

            wait(over)
            state.returned = True
            if not state.over:
                return

    # The program

    def _program(self, first: int, repetitions: int) -> Job:
        self._lines_run = 0
        for _ in range(repetitions):
            yield from self._pass(first)

    def _between_lines(self) -> Job:
        """What passes before every line but the first (decision 18)."""
        gap_ns = round(self._machine.options.line_gap_ms * NS_PER_MS)
        if self._lines_run and (gap_ns or self._lines_run % _HOLD_LINES == 0):
            yield self._pause(gap_ns or NS_PER_MS)
        self._lines_run += 1

    def _pass(self, index: int) -> Job:
        calls: list[_Return] = []
        lines = self._memory.lines
        while index < len(lines):
            yield from self._between_lines()
            line = lines[index]
            self.line = self._memory.number(index)
            yield from self._execute(line)
            target: int | None = index + 1
            if line.ends:
                return
            if line.returns and calls:
                call = calls[-1]
                call.left -= 1
                target = call.first
                if not call.left:
                    target = calls.pop().to
            elif line.returns:
                return
            elif line.subroutine is not None:
                number, times = line.subroutine
                target = self._memory.index(number)
                if target is not None:
                    calls.append(_Return(index + 1, target, times))
            elif line.jump is not None:
                target = self._memory.index(line.jump)
            if target is None:
                return
            index = target

    def _execute(self, line: Line) -> Job:
        for message in line.messages:
            self._say(message)
        for port in line.ports:
            yield from self._port(port)
        if line.filter is not None:
            self.filter = line.filter
        if line.screen is not None:
            self.screen = line.screen
        positions = [one for one in line.positions if self._only in (None, one.axis)]
        if positions:
            yield lambda over: self._position(positions, over)
        if line.counting is True:
            self._counter.begin()
        elif line.counting is False:
            self._counter.stop()
        if line.count_s is not None:
            interval_ns = round(line.count_s * NS_PER_S)
            yield lambda over: self._counter.count(interval_ns, lambda _: over())
        if line.delay_s is not None:
            yield self._pause(round(line.delay_s * NS_PER_S))

    def _pause(self, duration_ns: int) -> Callable[[Callable[[], None]], None]:
        def wait(over: Callable[[], None]) -> None:
            self._timer = self._machine.time.call_after(duration_ns, over)

        return wait

    # The i/o port

    def _port(self, port: Port) -> Job:
        machine = self._machine
        if port.name == "in":
            if port.level is not None:
                yield lambda over: self._await_input(port, over)
            elif port.number is not None:
                self._say(str(machine.inputs >> port.number & 1))
            else:
                self._say(str(machine.inputs))
            return
        assert port.number is not None
        if port.name == "out":
            machine.outputs = port.number
        elif port.name == "set":
            machine.outputs |= 1 << port.number
        else:
            machine.outputs &= ~(1 << port.number)

    def _await_input(self, port: Port, over: Callable[[], None]) -> None:
        if self._matches(port):
            over()
        else:
            self._waiting = (port, self._machine.time.now_ns(), over)

    def _matches(self, port: Port) -> bool:
        assert port.number is not None
        return bool(self._machine.inputs >> port.number & 1) == port.level

    def _input_changed(self) -> None:
        """The port is looked at every poll interval since the wait began; only a change can matter."""
        if self._waiting is None or self._timer is not None:
            return
        _, since_ns, _ = self._waiting
        poll_ns = round(self._machine.options.in_poll_ms * NS_PER_MS)
        if not poll_ns:
            self._look()
            return
        waited_ns = self._machine.time.now_ns() - since_ns
        self._timer = self._machine.time.call_at(since_ns + -(-waited_ns // poll_ns) * poll_ns, self._look)

    def _look(self) -> None:
        self._timer = None
        if self._waiting is None or not self._matches(self._waiting[0]):
            return
        _, _, over = self._waiting
        self._waiting = None
        over()

    # Positioning

    def _position(self, positions: list[Position], over: Callable[[], None]) -> None:
        """Start all axes of the line together; the line goes on when the last one has ended."""
        machine = self._machine
        left = len(positions)

        def ended(by_itself: bool) -> None:
            del by_itself
            nonlocal left
            left -= 1
            if not left:
                over()

        for one in positions:
            axis = machine.axis(one.axis)
            steps = axis.count(one.distance)
            target = steps if one.absolute else axis.steps + steps
            ramps = one.run_hz is not None
            profile = Profile(
                one.start_hz,
                one.run_hz if one.run_hz is not None else one.start_hz,
                (one.acceleration or 1.0) * 1000.0,
                (one.deceleration or 1.0) * 1000.0,
            )
            try:
                machine.check_target(target)
                if axis.task is not None:
                    raise Refused(f"axis {axis.number} is busy")
                start_ns = machine.start_ns() if len(positions) > 1 else None
                machine.launch(
                    axis, Kind.POSITIONING, positioning(machine, axis, target, profile, ramps, start_ns), ended
                )
            except Refused:
                ended(False)


@dataclass(slots=True)
class _Wait:
    """Whether a wait is over, and whether the call that began it has returned."""

    over: bool = False
    returned: bool = False


def _silent(text: str) -> None:
    del text
