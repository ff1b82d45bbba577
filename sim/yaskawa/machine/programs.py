"""Program threads: running their lines, breakpoints, errors, and automatic routines (L14361-L14423, L15443-L15613)."""

import random
from typing import Protocol

from sim.core.controller import FirmwareTiming
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.context import CommandContext, CommandMachine
from sim.yaskawa.language.model import LanguageModel
from sim.yaskawa.language.statements import CompiledStatement, RawData, compile_line
from sim.yaskawa.machine.events import AutomaticEvents
from sim.yaskawa.motion.trippoints import TripPoint, at_sample
from sim.yaskawa.program.threads import ProgramThread

_LOOPS_PER_SAMPLE = 4
"""Number of backward jumps per sample that an instant interpreter allows a thread, so that a busy loop costs little."""
_WAITING_OPS = ("WT", "JP", "#")


class FirmwareDelay:
    """Device time that commands take.

    program_ns: additional time of a command of a program."""

    def __init__(self, timing: FirmwareTiming, program_ns: int, seed: int) -> None:
        self.timing = timing
        self._program_ns = program_ns
        self._random = random.Random(seed)

    def draw_ns(self, *, program: bool) -> int:
        """Draw the time of the next command."""
        spread_ns = self.timing.spread_ns
        spent_ns = self.timing.decode_ns + (self._random.randrange(spread_ns + 1) if spread_ns else 0)
        return spent_ns + self._program_ns if program else spent_ns

    @property
    def is_instant(self) -> bool:
        """Return whether a program's command takes no time."""
        return not (self.timing.decode_ns or self._program_ns)


class ProgramMachine(CommandMachine, Protocol):
    """The machine as its program threads see it."""

    @property
    def model(self) -> LanguageModel: ...

    @property
    def events(self) -> AutomaticEvents: ...


class ProgramThreads:
    """The threads of one controller, and their execution line by line."""

    def __init__(self, machine: ProgramMachine, delay: FirmwareDelay) -> None:
        self.machine = machine
        self._delay = delay
        self.started: list[ProgramThread] = []
        """Threads that run, in the order of their numbers."""
        self.threads = [ProgramThread(number, self.started) for number in range(machine.model.threads)]
        self.contexts = [CommandContext(machine, thread) for thread in self.threads]
        self.trace = False
        self.break_at: tuple[int, int] | None = None
        self.break_hit = False
        self.break_thread = 0
        self.error_line = 0
        self.error_thread = 0
        self.error_index = 0
        self.interrupts = 0
        self.active_high = 0
        self.interrupts_on = False
        self.current: ProgramThread | None = None
        """The thread whose line has been started."""

    def reset_threads(self) -> None:
        """Power-up: stop all threads."""
        for thread in self.threads:
            thread.halt_thread()
        self.trace = self.break_hit = self.interrupts_on = False
        self.break_at = None
        self.interrupts = self.active_high = 0
        self.current = None

    def any_running(self) -> bool:
        return bool(self.started)

    def halt_all(self) -> None:
        for thread in self.threads:
            thread.halt_thread()

    def only_waits(self, thread: ProgramThread) -> bool:
        """Return whether the rest of its line only waits and jumps."""
        return all(statement.op in _WAITING_OPS for statement in self.compiled_line(thread.line)[thread.index :])

    def compiled_line(self, number: int) -> tuple[CompiledStatement, ...]:
        """Return the compiled statements of a program line."""
        lines = self.machine.program.lines
        return compile_line(lines[number], self.machine.model) if number < len(lines) else ()

    def step_thread(self, thread: ProgramThread) -> None:
        """Run the next statement of a thread."""
        lines = self.machine.program.lines
        if thread.line >= len(lines):
            thread.halt_thread()
            return
        if thread.index == 0:
            if self._reaches_break(thread):
                return
            if self.trace:
                self.machine.ports.send_message(f"{thread.line:03d} {lines[thread.line]}\r\n")
            self.machine.events.start_due_routines()
        statements = self.compiled_line(thread.line)
        self.current = thread
        while thread.index < len(statements) and statements[thread.index].quiet:
            thread.index += 1
        if thread.index >= len(statements):
            self._next_line(thread)
            return
        statement = statements[thread.index]
        position = (thread.line, thread.index)
        thread.index += 1
        try:
            outcome = statement.run_statement(self.contexts[thread.number])
        except CommandError as error:
            self._handle_failure(thread, position, error.code)
            return
        if isinstance(outcome, TripPoint):
            self.block_thread(thread, outcome)
        elif outcome is not None:
            self.machine.ports.send_message(outcome if isinstance(outcome, RawData) else f"{outcome}\r\n")
        if thread.running and (thread.line == position[0]) and thread.index >= len(self.compiled_line(thread.line)):
            self._next_line(thread)

    def block_thread(self, thread: ProgramThread, trip: TripPoint) -> None:
        """Block `thread`, unless the condition is fulfilled already."""
        if not trip.passed(self.machine, self.machine.current_sample()):
            thread.trip = trip

    def _next_line(self, thread: ProgramThread) -> None:
        thread.line += 1
        thread.index = 0
        thread.passed_break = False
        if thread.steps:
            thread.steps -= 1
            if not thread.steps:
                thread.paused = True
                self.break_hit, self.break_at = True, (thread.line, thread.number)

    def jump_to(self, thread: ProgramThread, line: int) -> None:
        """Continue at `line`; an instant interpreter delays a thread that loops without waiting."""
        backward = line <= thread.line
        thread.line, thread.index, thread.passed_break = line, 0, False
        if backward:
            self.count_loop(thread)

    def count_loop(self, thread: ProgramThread) -> None:
        """Count a loop of `thread` in this sample."""
        sample_now = self.machine.current_sample()
        if thread.spin_sample != sample_now:
            thread.spin_sample, thread.spins = sample_now, 0
        thread.spins += 1
        if thread.spins > _LOOPS_PER_SAMPLE and thread.trip is None and self._delay.is_instant:
            thread.trip, thread.resting = at_sample(sample_now + 1), True

    def _reaches_break(self, thread: ProgramThread) -> bool:
        if self.break_at == (thread.line, thread.number) and not self.break_hit and not thread.passed_break:
            self.break_hit = True
            self.break_thread = thread.number
            thread.paused = thread.passed_break = True
            return True
        return False

    def _handle_failure(self, thread: ProgramThread, place: tuple[int, int], code: int) -> None:
        machine = self.machine
        machine.refuse_command(code)
        self.error_line, self.error_thread, self.error_index = place[0], thread.number, place[1]
        main = self.threads[0]
        handler = machine.program.labels.get("CMDERR")
        if handler is not None and main.running:
            if thread is not main:
                thread.halt_thread()
            try:
                main.call_subroutine(handler, event="CMDERR")
                self.count_loop(main)
                return
            except CommandError as overflow:
                machine.refuse_command(overflow.code)
                thread = main
        thread.halt_thread()
        machine.ports.send_message(f"?{place[0]:03d} {machine.program.lines[place[0]]}\r\n")

    def raise_event(self, name: str) -> bool:
        """Jump thread 0 to an automatic routine; return False when there is none, or it cannot run (L15487)."""
        main = self.threads[0]
        label = self.machine.program.labels.get(name)
        if label is None or not main.running or any(frame.event == name for frame in main.stack):
            return False
        try:
            main.call_subroutine(label, event=name)
        except CommandError as error:
            self.machine.refuse_command(error.code)
            return False
        self.count_loop(main)
        return True

    def skip_block(self, thread: ProgramThread, *, to_else: bool) -> None:
        """Continue after the ELSE or ENDIF of the block that contains `thread` (L15338)."""
        depth = 0
        line, index = thread.line, thread.index
        while line < len(self.machine.program.lines):
            for number, statement in enumerate(self.compiled_line(line)):
                if number < index:
                    continue
                if statement.op == "IF":
                    depth += 1
                elif statement.op == "ENDIF" or (statement.op == "ELSE" and to_else and depth == 0):
                    if depth == 0:
                        thread.line, thread.index = line, number + 1
                        if thread.index >= len(self.compiled_line(line)):
                            thread.line, thread.index = line + 1, 0
                        return
                    depth -= 1
            line, index = line + 1, 0
        raise CommandError(63)
