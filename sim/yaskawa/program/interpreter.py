"""The one interpreter that threads and ports share, line by line (L1626, L14633, D27)."""

from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING

from orchestrator.clock.base import NS_PER_MS
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.timebase import NEVER_NS
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.statements import CompiledStatement, RawData, compile_line
from sim.yaskawa.motion.trippoints import TripPoint, at_sample
from sim.yaskawa.program.threads import ProgramThread

if TYPE_CHECKING:
    from sim.yaskawa.machine import ControllerCore
    from sim.yaskawa.ports.ports import PortSession

_LOOPS_PER_SAMPLE = 4
"""Number of backward jumps per sample that an instant interpreter allows a thread, so that a busy loop costs little."""

NO_BREAK = -2147483648

LEEWAY_NS = 20 * NS_PER_MS
"""Allowed delay, live, of a program that only waits and jumps, and of the first of several commands that arrived
together: otherwise sixteen programs that poll a release gate wake for each command, and keep two processors from
their real work. An access from outside still finds the correct state."""
_WAITING_OPS = ("WT", "JP", "#")


class SharedInterpreter:
    """Alternates between one command of a port and one line of a thread. Each command takes `delay_ns` of device
    time."""

    def __init__(self, machine: "ControllerCore", delay_ns: Callable[[bool], int]) -> None:
        self.machine = machine
        self.delay_ns = delay_ns
        self.threads = [ProgramThread(number) for number in range(machine.model.threads)]
        self.contexts = [CommandContext(machine, thread) for thread in self.threads]
        self.busy = False
        self.decoded_ns = NEVER_NS
        """True instant at which the present command will have been decoded."""
        self.leeway_ns = 0
        """Allowed delay of its processing."""
        self._decoding: tuple[PortSession | None, ProgramThread | None] = (None, None)
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
        self._current: ProgramThread | None = None
        self._turn = 0

    def reset_threads(self) -> None:
        """Power-up: stop everything."""
        for thread in self.threads:
            thread.halt_thread()
        self.trace = self.break_hit = self.interrupts_on = False
        self._cancel_decoding()
        self.break_at = None
        self.interrupts = self.active_high = 0
        self._current = None

    def any_running(self) -> bool:
        return any(thread.running for thread in self.threads)

    def halt_all(self) -> None:
        for thread in self.threads:
            thread.halt_thread()

    def next_check(self, now: int) -> float:
        """Return the next sample at which a waiting thread or port has to be checked."""
        due = inf
        for thread in self.threads:
            if thread.trip is not None:
                due = min(due, thread.trip.due(self.machine, now))
        for port in self.machine.ports.open_ports():
            if port.trip is not None:
                due = min(due, port.trip.due(self.machine, now))
        return due

    def only_waits_at(self, due: float, now: int) -> bool:
        """Return whether those due by then are programs that only wait and jump."""
        if any(port.trip is not None for port in self.machine.ports.open_ports()):
            return False
        return all(
            thread.trip is None or thread.trip.due(self.machine, now) > due or self.only_waits(thread)
            for thread in self.threads
        )

    def resume_waiting(self, now: int) -> None:
        """Resume those whose condition is fulfilled."""
        for thread in self.threads:
            if thread.trip is not None and thread.trip.passed(self.machine, now):
                thread.trip, thread.resting = None, False
        for port in self.machine.ports.open_ports():
            if port.trip is not None and port.trip.passed(self.machine, now):
                port.trip = None
                port.accept_command(None)

    def run_ready(self) -> None:
        """Run all that is ready; return by the clock when commands take time."""
        if self.busy and self.leeway_ns and any(port.queue for port in self.machine.ports.open_ports()):
            self.leeway_ns = 0
            self.machine.set_alarm()
        while not self.busy:
            port, thread = self._choose_next()
            if port is None and thread is None:
                return
            delay_ns = self.delay_ns(port is None)
            if not delay_ns:
                self._perform_decoded(port, thread)
                continue
            self._begin_decoding(port, thread, delay_ns)
            self.leeway_ns = self._leeway_ns(port, thread, delay_ns)
            self.machine.set_alarm()

    def _begin_decoding(self, port: "PortSession | None", thread: ProgramThread | None, delay_ns: int) -> None:
        """Begin to decode the next command of a port or a thread."""
        self.busy = True
        self.decoded_ns = self.machine.timebase.after_ns(delay_ns)
        self._decoding = (port, thread)

    def _leeway_ns(self, port: "PortSession | None", thread: ProgramThread | None, delay_ns: int) -> int:
        if any(each.queue for each in self.machine.ports.open_ports() if each is not port):
            return 0
        if port is not None:
            # Commands that arrived together are answered together.
            return min(LEEWAY_NS, (len(port.queue) - 1) * delay_ns)
        return LEEWAY_NS if thread is not None and self.only_waits(thread) else 0

    def only_waits(self, thread: ProgramThread) -> bool:
        """Return whether the rest of its line only waits and jumps."""
        return all(each.op in _WAITING_OPS for each in self.compiled_line(thread.line)[thread.index :])

    def run_decoded(self) -> None:
        """Run the present command, which was decoded at its `decoded_ns`."""
        port, thread = self._decoding
        timebase = self.machine.timebase
        timebase.begin_event(self.decoded_ns)
        self._cancel_decoding()
        try:
            self.machine.settle_events()
            self._perform_decoded(port, thread)
            self.machine.run_ready()
        finally:
            timebase.end_event()

    def _cancel_decoding(self) -> None:
        """Cancel the decoding in progress."""
        self.busy = False
        self.decoded_ns, self.leeway_ns = NEVER_NS, 0

    def poll_alone(self, wake_ns: int, before_ns: int) -> bool:
        """Run a program that only waits and jumps up to `before_ns`, if no other event can interfere; return whether
        it did. The result equals that of `run_decoded` and of the check at each sample, one after the other, in
        half of the time: sixteen that poll a release gate took half a processor.

        wake_ns: the instant of the sample that it waits for.
        """
        machine, timebase = self.machine, self.machine.timebase
        thread = self._sole_program()
        if thread is None:
            return False
        done = False
        try:
            while thread.line < len(machine.program.lines) and self.only_waits(thread):
                due_ns = self.decoded_ns if self.busy else wake_ns
                if due_ns >= before_ns:
                    break
                timebase.begin_event(due_ns)
                if self.busy:
                    self._cancel_decoding()
                    self._step_thread(thread)
                elif thread.trip is not None and thread.trip.passed(machine, machine.current_sample()):
                    thread.trip, thread.resting = None, False
                else:
                    break
                done = True
                if thread.trip is not None:
                    now = machine.current_sample()
                    due = thread.trip.due(machine, now)
                    wake_ns = NEVER_NS if due == inf else timebase.true_ns(int(max(due, now)))
                elif thread.is_ready:
                    self._choose_next()
                    self._begin_decoding(None, thread, self.delay_ns(True))
                else:
                    break
            if done:
                if self.busy and self.only_waits(thread):
                    self.leeway_ns = LEEWAY_NS
                machine.discard_schedule()
        finally:
            timebase.end_event()
        return done

    def _sole_program(self) -> ProgramThread | None:
        """Return the only active program of the controller, if it only waits and jumps."""
        machine = self.machine
        running = [thread for thread in self.threads if thread.running]
        if len(running) != 1 or running[0].paused or not self.only_waits(running[0]):
            return None
        thread = running[0]
        if (
            (self.busy and self._decoding != (None, thread))
            or machine.instant_programs
            or machine.next_event_sample() != inf
        ):
            return None
        if self.trace or self.break_at is not None or machine.events.has_routines:
            return None
        if any(port.queue or port.trip is not None for port in machine.ports.open_ports()):
            return None
        return thread

    def _choose_next(self) -> "tuple[PortSession | None, ProgramThread | None]":
        current = self._current
        if self.machine.model.by_trigger_line and current is not None and current.is_ready and current.index:
            return None, current
        self._current = None
        first = self._turn
        ready = [thread for thread in self.threads if thread.running and thread.is_ready]
        for thread in ready:
            if 0 < first <= thread.number + 1:
                return None, self._take_turn(thread)
        for port in self.machine.ports.open_ports():
            if port.queue and port.trip is None:
                self._turn = 1
                return port, None
        return None, self._take_turn(ready[0]) if ready else None

    def _take_turn(self, thread: ProgramThread) -> ProgramThread:
        self._turn = (thread.number + 2) % (len(self.threads) + 1)
        return thread

    def _perform_decoded(self, port: "PortSession | None", thread: ProgramThread | None) -> None:
        if port is not None:
            port.run_next()
        elif thread is not None and thread.is_ready:
            self._step_thread(thread)

    # Threads

    def compiled_line(self, number: int) -> tuple[CompiledStatement, ...]:
        """Return the compiled statements of a program line."""
        lines = self.machine.program.lines
        return compile_line(lines[number], self.machine.model) if number < len(lines) else ()

    def _step_thread(self, thread: ProgramThread) -> None:
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
        self._current = thread
        while thread.index < len(statements) and statements[thread.index].quiet:
            thread.index += 1
        if thread.index >= len(statements):
            self._next_line(thread)
            return
        statement = statements[thread.index]
        place = (thread.line, thread.index)
        thread.index += 1
        try:
            outcome = statement.run_statement(self.contexts[thread.number])
        except CommandError as error:
            self._handle_failure(thread, place, error.code)
            return
        if isinstance(outcome, TripPoint):
            self.block_thread(thread, outcome)
        elif outcome is not None:
            self.machine.ports.send_message(outcome if isinstance(outcome, RawData) else f"{outcome}\r\n")
        if thread.running and (thread.line == place[0]) and thread.index >= len(self.compiled_line(thread.line)):
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
        now = self.machine.current_sample()
        if thread.spin_sample != now:
            thread.spin_sample, thread.spins = now, 0
        thread.spins += 1
        if thread.spins > _LOOPS_PER_SAMPLE and thread.trip is None and self.machine.instant_programs:
            thread.trip, thread.resting = at_sample(now + 1), True

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
