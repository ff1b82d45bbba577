"""The one interpreter that threads and ports share, line by line (L1626, L14633, D27)."""

from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING

from orchestrator.clock.base import NS_PER_MS
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.timebase import NEVER_NS
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.statements import Raw, Statement, compile_line
from sim.yaskawa.motion.trippoints import Trip, at_sample
from sim.yaskawa.program.threads import Thread

if TYPE_CHECKING:
    from sim.yaskawa.machine import Machine
    from sim.yaskawa.ports.ports import Port

_LOOPS_PER_SAMPLE = 4
"""How often an instant interpreter lets a thread jump backward in one sample, so that a busy loop costs little."""

NO_BREAK = -2147483648

LEEWAY_NS = 20 * NS_PER_MS
"""How late, live, a program may be seen to that does nothing but wait and jump, and the first of several commands that
came together: sixteen that poll a gate are woken for each command else, and keep two processors from what they are
there for. Who looks finds all where it should be."""
_UNSEEN = ("WT", "JP", "#")


class Interpreter:
    """Takes turns: one command of a port, one line of a thread. Each command takes `decode` device time."""

    def __init__(self, machine: "Machine", delay_ns: Callable[[bool], int]) -> None:
        self.machine = machine
        self.delay_ns = delay_ns
        self.threads = [Thread(number) for number in range(machine.model.threads)]
        self.contexts = [Context(machine, thread) for thread in self.threads]
        self.busy = False
        self.decoded_ns = NEVER_NS
        """True instant at which the command under way will have been decoded."""
        self.leeway_ns = 0
        """How much later that may be seen to."""
        self._decoding: tuple[Port | None, Thread | None] = (None, None)
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
        self._current: Thread | None = None
        self._turn = 0

    def reset(self) -> None:
        """Power-up: nothing runs."""
        for thread in self.threads:
            thread.halt()
        self.trace = self.break_hit = self.interrupts_on = False
        self._forget()
        self.break_at = None
        self.interrupts = self.active_high = 0
        self._current = None

    def any_running(self) -> bool:
        return any(thread.running for thread in self.threads)

    def halt_all(self) -> None:
        for thread in self.threads:
            thread.halt()

    def due(self, now: int) -> float:
        """The next sample at which a waiting thread or port has to be looked at."""
        due = inf
        for thread in self.threads:
            if thread.trip is not None:
                due = min(due, thread.trip.due(self.machine, now))
        for port in self.machine.ports.all():
            if port.trip is not None:
                due = min(due, port.trip.due(self.machine, now))
        return due

    def unseen_at(self, due: float, now: int) -> bool:
        """Whether those that are due by then are programs that only wait and jump."""
        if any(port.trip is not None for port in self.machine.ports.all()):
            return False
        return all(
            thread.trip is None or thread.trip.due(self.machine, now) > due or self.unseen(thread)
            for thread in self.threads
        )

    def release(self, now: int) -> None:
        """Let go what has waited for something that has happened."""
        for thread in self.threads:
            if thread.trip is not None and thread.trip.passed(self.machine, now):
                thread.trip, thread.resting = None, False
        for port in self.machine.ports.all():
            if port.trip is not None and port.trip.passed(self.machine, now):
                port.trip = None
                port.accept(None)

    def pump(self) -> None:
        """Run whatever is ready; come back by the clock when commands take time."""
        if self.busy and self.leeway_ns and any(port.queue for port in self.machine.ports.all()):
            self.leeway_ns = 0
            self.machine.set_alarm()
        while not self.busy:
            port, thread = self._choose()
            if port is None and thread is None:
                return
            delay_ns = self.delay_ns(port is None)
            if not delay_ns:
                self._perform(port, thread)
                continue
            self._decode(port, thread, delay_ns)
            self.leeway_ns = self._leeway_ns(port, thread, delay_ns)
            self.machine.set_alarm()

    def _decode(self, port: "Port | None", thread: Thread | None, delay_ns: int) -> None:
        """Begin with the next command of one of them."""
        self.busy = True
        self.decoded_ns = self.machine.timebase.after_ns(delay_ns)
        self._decoding = (port, thread)

    def _leeway_ns(self, port: "Port | None", thread: Thread | None, delay_ns: int) -> int:
        if any(each.queue for each in self.machine.ports.all() if each is not port):
            return 0
        if port is not None:
            # What came together is answered together.
            return min(LEEWAY_NS, (len(port.queue) - 1) * delay_ns)
        return LEEWAY_NS if thread is not None and self.unseen(thread) else 0

    def unseen(self, thread: Thread) -> bool:
        """Whether all that the rest of its line does is to wait and to jump."""
        return all(each.op in _UNSEEN for each in self.line(thread.line)[thread.index :])

    def decoded(self) -> None:
        """The command under way has been decoded, at its `decoded_ns`: run it."""
        port, thread = self._decoding
        timebase = self.machine.timebase
        timebase.begin(self.decoded_ns)
        self._forget()
        try:
            self.machine.settle()
            self._perform(port, thread)
            self.machine.go_on()
        finally:
            timebase.end()

    def _forget(self) -> None:
        """Nothing is being decoded any more."""
        self.busy = False
        self.decoded_ns, self.leeway_ns = NEVER_NS, 0

    def poll_alone(self, wake_ns: int, before_ns: int) -> bool:
        """Have a program that only waits and jumps do so up to `before_ns`, if there is nothing else that it could
        meet; whether it has. It does just what `decoded` and the look at each sample would, one after the other, in
        half of the time: sixteen that poll a gate took half a processor. wake_ns: when the sample comes that it waits
        for.
        """
        machine, timebase = self.machine, self.machine.timebase
        thread = self._alone()
        if thread is None:
            return False
        done = False
        try:
            while thread.line < len(machine.program.lines) and self.unseen(thread):
                due_ns = self.decoded_ns if self.busy else wake_ns
                if due_ns >= before_ns:
                    break
                timebase.begin(due_ns)
                if self.busy:
                    self._forget()
                    self._step(thread)
                elif thread.trip is not None and thread.trip.passed(machine, machine.now()):
                    thread.trip, thread.resting = None, False
                else:
                    break
                done = True
                if thread.trip is not None:
                    now = machine.now()
                    due = thread.trip.due(machine, now)
                    wake_ns = NEVER_NS if due == inf else timebase.true_ns(int(max(due, now)))
                elif thread.ready:
                    self._choose()
                    self._decode(None, thread, self.delay_ns(True))
                else:
                    break
            if done:
                if self.busy and self.unseen(thread):
                    self.leeway_ns = LEEWAY_NS
                machine.moved_on()
        finally:
            timebase.end()
        return done

    def _alone(self) -> Thread | None:
        """The program that is all that goes on in the controller, if it only waits and jumps."""
        machine = self.machine
        running = [thread for thread in self.threads if thread.running]
        if len(running) != 1 or running[0].paused or not self.unseen(running[0]):
            return None
        thread = running[0]
        if (self.busy and self._decoding != (None, thread)) or machine.instant_programs or machine.soon() != inf:
            return None
        if self.trace or self.break_at is not None or machine.events.watched:
            return None
        if any(port.queue or port.trip is not None for port in machine.ports.all()):
            return None
        return thread

    def _choose(self) -> "tuple[Port | None, Thread | None]":
        current = self._current
        if self.machine.model.by_line and current is not None and current.ready and current.index:
            return None, current
        self._current = None
        first = self._turn
        ready = [thread for thread in self.threads if thread.running and thread.ready]
        for thread in ready:
            if 0 < first <= thread.number + 1:
                return None, self._chosen(thread)
        for port in self.machine.ports.all():
            if port.queue and port.trip is None:
                self._turn = 1
                return port, None
        return None, self._chosen(ready[0]) if ready else None

    def _chosen(self, thread: Thread) -> Thread:
        self._turn = (thread.number + 2) % (len(self.threads) + 1)
        return thread

    def _perform(self, port: "Port | None", thread: Thread | None) -> None:
        if port is not None:
            port.run_next()
        elif thread is not None and thread.ready:
            self._step(thread)

    # Threads

    def line(self, number: int) -> tuple[Statement, ...]:
        """The compiled statements of a program line."""
        lines = self.machine.program.lines
        return compile_line(lines[number], self.machine.model) if number < len(lines) else ()

    def _step(self, thread: Thread) -> None:
        lines = self.machine.program.lines
        if thread.line >= len(lines):
            thread.halt()
            return
        if thread.index == 0:
            if self._breaks(thread):
                return
            if self.trace:
                self.machine.ports.message(f"{thread.line:03d} {lines[thread.line]}\r\n")
            self.machine.events.poll()
        statements = self.line(thread.line)
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
            outcome = statement.execute(self.contexts[thread.number])
        except CommandError as error:
            self._failed(thread, place, error.code)
            return
        if isinstance(outcome, Trip):
            self.hold(thread, outcome)
        elif outcome is not None:
            self.machine.ports.message(outcome if isinstance(outcome, Raw) else f"{outcome}\r\n")
        if thread.running and (thread.line == place[0]) and thread.index >= len(self.line(thread.line)):
            self._next_line(thread)

    def hold(self, thread: Thread, trip: Trip) -> None:
        """`thread` waits, unless the condition is fulfilled already."""
        if not trip.passed(self.machine, self.machine.now()):
            thread.trip = trip

    def _next_line(self, thread: Thread) -> None:
        thread.line += 1
        thread.index = 0
        thread.passed_break = False
        if thread.steps:
            thread.steps -= 1
            if not thread.steps:
                thread.paused = True
                self.break_hit, self.break_at = True, (thread.line, thread.number)

    def jump(self, thread: Thread, line: int) -> None:
        """Go on at `line`; an instant interpreter makes a thread that loops without waiting rest a while."""
        backward = line <= thread.line
        thread.line, thread.index, thread.passed_break = line, 0, False
        if backward:
            self.tire(thread)

    def tire(self, thread: Thread) -> None:
        """Count a loop of `thread` in this sample."""
        now = self.machine.now()
        if thread.spin_sample != now:
            thread.spin_sample, thread.spins = now, 0
        thread.spins += 1
        if thread.spins > _LOOPS_PER_SAMPLE and thread.trip is None and self.machine.instant_programs:
            thread.trip, thread.resting = at_sample(now + 1), True

    def _breaks(self, thread: Thread) -> bool:
        if self.break_at == (thread.line, thread.number) and not self.break_hit and not thread.passed_break:
            self.break_hit = True
            self.break_thread = thread.number
            thread.paused = thread.passed_break = True
            return True
        return False

    def _failed(self, thread: Thread, place: tuple[int, int], code: int) -> None:
        machine = self.machine
        machine.fail(code)
        self.error_line, self.error_thread, self.error_index = place[0], thread.number, place[1]
        main = self.threads[0]
        handler = machine.program.labels.get("CMDERR")
        if handler is not None and main.running:
            if thread is not main:
                thread.halt()
            try:
                main.call(handler, event="CMDERR")
                self.tire(main)
                return
            except CommandError as overflow:
                machine.fail(overflow.code)
                thread = main
        thread.halt()
        machine.ports.message(f"?{place[0]:03d} {machine.program.lines[place[0]]}\r\n")

    def raise_event(self, name: str) -> bool:
        """Jump thread 0 to an automatic routine; False when there is none, or it cannot run (L15487)."""
        main = self.threads[0]
        label = self.machine.program.labels.get(name)
        if label is None or not main.running or any(frame.event == name for frame in main.stack):
            return False
        try:
            main.call(label, event=name)
        except CommandError as error:
            self.machine.fail(error.code)
            return False
        self.tire(main)
        return True

    def skip_block(self, thread: Thread, *, to_else: bool) -> None:
        """Go on behind the ELSE or ENDIF of the block that `thread` is in (L15338)."""
        depth = 0
        line, index = thread.line, thread.index
        while line < len(self.machine.program.lines):
            for number, statement in enumerate(self.line(line)):
                if number < index:
                    continue
                if statement.op == "IF":
                    depth += 1
                elif statement.op == "ENDIF" or (statement.op == "ELSE" and to_else and depth == 0):
                    if depth == 0:
                        thread.line, thread.index = line, number + 1
                        if thread.index >= len(self.line(line)):
                            thread.line, thread.index = line + 1, 0
                        return
                    depth -= 1
            line, index = line + 1, 0
        raise CommandError(63)
