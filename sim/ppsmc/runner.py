"""Program execution: line after line, in each line the part jobs in their fixed order (L3216-L3222)."""

from collections.abc import Callable, Generator
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, ClockTimer
from sim.ppsmc.counter import PulseCounter
from sim.ppsmc.grammar import InputRefused
from sim.ppsmc.legs import TaskKind
from sim.ppsmc.machine import StepperHardware
from sim.ppsmc.moves import PositioningStart, positioning_steps
from sim.ppsmc.path import SpeedProfile
from sim.ppsmc.program import JobLine, PortJob, PositioningCommand, ProgramMemory

Say = Callable[[str], None]
_YIELD_LINES = 1000
"""Lines without any wait after which a program yields for a moment: an endless loop must not stop time."""


@dataclass(slots=True)
class _ActiveSubroutine:
    """A running gosub: the line after it, the subroutine's first line, and repetitions left."""

    to: int
    first: int
    left: int


Job = Generator[Callable[[Callable[[], None]], None], None, None]
"""Yields waits: each takes the callback to be called when it is over."""


class ProgramRunner:
    """Runs the program in the memory. Waits are events; a program that waits for an input schedules nothing."""

    def __init__(self, machine: StepperHardware, memory: ProgramMemory, counter: PulseCounter) -> None:
        self._machine = machine
        self._memory = memory
        self._counter = counter
        self._job: Job | None = None
        self._timer: ClockTimer | None = None
        self._waiting: tuple[PortJob, int, Callable[[], None]] | None = None
        self._only: int | None = None
        self._send: Say = _discard_text
        self._lines_run = 0
        self.line = 0
        """Number of the line being executed; 0 without a program."""
        self.filter = 1
        self.screen = 0
        machine.on_input = self._input_changed

    @property
    def is_running(self) -> bool:
        return self._job is not None

    def start_program(self, first: int | None, only: int | None, repetitions: int, send: Say) -> None:
        """Run from line number `first` (None: the beginning), on axis `only` (None: all). Raises `InputRefused`.

        `send` receives messages and input states.
        """
        index = 0 if first is None else self._memory.find_index(first)
        if index is None:
            raise InputRefused(f"no program line {first}")
        if not self._memory.lines:
            raise InputRefused("no program")
        self._only, self._send = only, send
        self._job = self._program_job(index, repetitions)
        self._run_to_wait()

    def abort_program(self) -> None:
        """End the program; its motions are stopped by the machine."""
        if self._job is None:
            return
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        job, self._job, self._waiting, self.line = self._job, None, None, 0
        job.close()
        self._counter.cancel_count()

    def _run_to_wait(self) -> None:
        """Continue until the next wait; waits that are over at once do not grow the stack."""
        self._timer = None
        while self._job is not None:
            job = self._job
            wait = next(job, None)
            if wait is None:
                self._job, self.line = None, 0
                return
            state = _WaitState()

            def finish_wait(state: _WaitState = state, job: Job = job) -> None:
                state.over = True
                if state.returned and self._job is job:
                    self._run_to_wait()

            wait(finish_wait)
            state.returned = True
            if not state.over:
                return

    # The program

    def _program_job(self, first: int, repetitions: int) -> Job:
        self._lines_run = 0
        for _ in range(repetitions):
            yield from self._line_job(first)

    def _between_lines(self) -> Job:
        """Wait before every line but the first (decision 18)."""
        gap_ns = round(self._machine.options.line_gap_ms * NS_PER_MS)
        if self._lines_run and (gap_ns or self._lines_run % _YIELD_LINES == 0):
            yield self._pause_wait(gap_ns or NS_PER_MS)
        self._lines_run += 1

    def _line_job(self, index: int) -> Job:
        calls: list[_ActiveSubroutine] = []
        lines = self._memory.lines
        while index < len(lines):
            yield from self._between_lines()
            line = lines[index]
            self.line = self._memory.line_number(index)
            yield from self._part_jobs(line)
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
                target = self._memory.find_index(number)
                if target is not None:
                    calls.append(_ActiveSubroutine(index + 1, target, times))
            elif line.jump is not None:
                target = self._memory.find_index(line.jump)
            if target is None:
                return
            index = target

    def _part_jobs(self, line: JobLine) -> Job:
        for message in line.messages:
            self._send(message)
        for port in line.ports:
            yield from self._port_job(port)
        if line.filter is not None:
            self.filter = line.filter
        if line.screen is not None:
            self.screen = line.screen
        positions = [position for position in line.positions if self._only in (None, position.axis)]
        if positions:
            yield lambda over: self._start_positions(positions, over)
        if line.counting is True:
            self._counter.begin_count()
        elif line.counting is False:
            self._counter.stop_count()
        if line.count_s is not None:
            interval_ns = round(line.count_s * NS_PER_S)
            yield lambda over: self._counter.count_interval(interval_ns, lambda _: over())
        if line.delay_s is not None:
            yield self._pause_wait(round(line.delay_s * NS_PER_S))

    def _pause_wait(self, duration_ns: int) -> Callable[[Callable[[], None]], None]:
        def start_pause(over: Callable[[], None]) -> None:
            self._timer = self._machine.time.call_after(duration_ns, over)

        return start_pause

    # The i/o port

    def _port_job(self, port: PortJob) -> Job:
        machine = self._machine
        if port.name == "in":
            if port.level is not None:
                yield lambda over: self._await_input(port, over)
            elif port.number is not None:
                self._send(str(machine.inputs >> port.number & 1))
            else:
                self._send(str(machine.inputs))
            return
        assert port.number is not None
        if port.name == "out":
            machine.output_byte = port.number
        elif port.name == "set":
            machine.output_byte |= 1 << port.number
        else:
            machine.output_byte &= ~(1 << port.number)

    def _await_input(self, port: PortJob, over: Callable[[], None]) -> None:
        if self._input_matches(port):
            over()
        else:
            self._waiting = (port, self._machine.time.now_ns(), over)

    def _input_matches(self, port: PortJob) -> bool:
        assert port.number is not None
        return bool(self._machine.inputs >> port.number & 1) == port.level

    def _input_changed(self) -> None:
        """Poll the port every poll interval since the wait began; only a change can matter."""
        if self._waiting is None or self._timer is not None:
            return
        _, since_ns, _ = self._waiting
        poll_ns = round(self._machine.options.in_poll_ms * NS_PER_MS)
        if not poll_ns:
            self._poll_input()
            return
        waited_ns = self._machine.time.now_ns() - since_ns
        self._timer = self._machine.time.call_at(since_ns + -(-waited_ns // poll_ns) * poll_ns, self._poll_input)

    def _poll_input(self) -> None:
        self._timer = None
        if self._waiting is None or not self._input_matches(self._waiting[0]):
            return
        _, _, over = self._waiting
        self._waiting = None
        over()

    # Positioning

    def _start_positions(self, positions: list[PositioningCommand], over: Callable[[], None]) -> None:
        """Start all axes of the line together; the line continues when the last one has ended."""
        machine = self._machine
        count = len(positions)

        def handle_axis_end() -> None:
            nonlocal count
            count -= 1
            if not count:
                over()

        for position in positions:
            axis = machine.find_axis(position.axis)
            steps = axis.count_steps(position.distance)
            target = steps if position.absolute else axis.steps + steps
            ramps = position.run_hz is not None
            profile = SpeedProfile(
                position.start_hz,
                position.run_hz if position.run_hz is not None else position.start_hz,
                (position.acceleration or 1.0) * 1000.0,
                (position.deceleration or 1.0) * 1000.0,
            )
            try:
                machine.check_target(target)
                if axis.task is not None:
                    raise InputRefused(f"axis {axis.number} is busy")
                start_ns = machine.group_start_ns() if len(positions) > 1 else None
                machine.launch_task(
                    axis,
                    TaskKind.POSITIONING,
                    positioning_steps(machine, axis, target, PositioningStart(profile, start_ns, ramps)),
                    handle_axis_end,
                )
            except InputRefused:
                handle_axis_end()


@dataclass(slots=True)
class _WaitState:
    """State of a wait: whether it is over, and whether the call that began it has returned."""

    over: bool = False
    returned: bool = False


def _discard_text(text: str) -> None:
    del text
