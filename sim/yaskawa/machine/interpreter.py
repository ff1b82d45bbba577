"""The one interpreter that threads and ports share, line by line (L1626, L14633, D27)."""

from math import inf
from typing import Protocol

from orchestrator.clock.base import NS_PER_MS
from sim.yaskawa.base.timebase import NEVER_NS
from sim.yaskawa.language.context import CommandMachine
from sim.yaskawa.language.model import LanguageModel
from sim.yaskawa.machine.events import AutomaticEvents
from sim.yaskawa.machine.programs import FirmwareDelay, ProgramThreads
from sim.yaskawa.ports.ports import PortSession, PortSet
from sim.yaskawa.program.threads import ProgramThread

LEEWAY_NS = 20 * NS_PER_MS
"""Allowed delay, live, of a program that only waits and jumps, and of the first of several commands that arrived
together: otherwise sixteen programs that poll a release gate wake for each command, and keep two processors from
their real work. An access from outside still finds the correct state."""


class AlarmSchedule(Protocol):
    """The schedule as the interpreter changes it."""

    def set_alarm(self) -> None:
        """Set the alarm for the earliest event."""
        ...

    def discard_schedule(self) -> None:
        """Discard the schedule after the next event was processed elsewhere."""
        ...


class InterpretedMachine(CommandMachine, Protocol):
    """The machine as its interpreter sees it."""

    @property
    def model(self) -> LanguageModel: ...

    @property
    def ports(self) -> PortSet: ...

    @property
    def events(self) -> AutomaticEvents: ...

    @property
    def programs(self) -> ProgramThreads: ...

    @property
    def schedule(self) -> AlarmSchedule: ...

    def settle_events(self) -> None:
        """Advance motion, recording and trippoints to the present sample."""
        ...

    def next_event_sample(self) -> float:
        """Return the next sample with an event that no program causes."""
        ...


class SharedInterpreter:
    """Alternates between one command of a port and one line of a thread. Each command takes device time."""

    def __init__(self, machine: InterpretedMachine, delay: FirmwareDelay) -> None:
        self.machine = machine
        self.programs = machine.programs
        self._delay = delay
        self.busy = False
        self.decoded_ns = NEVER_NS
        """True instant at which the present command will have been decoded."""
        self.leeway_ns = 0
        """Allowed delay of its processing."""
        self._decoding: tuple[PortSession | None, ProgramThread | None] = (None, None)
        self._turn = 0

    def reset_threads(self) -> None:
        """Power-up: stop everything."""
        self.programs.reset_threads()
        self._cancel_decoding()

    def next_check(self, now: int) -> float:
        """Return the next sample at which a waiting thread or port has to be checked."""
        due = inf
        for thread in self.programs.started:
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
            thread.trip is None or thread.trip.due(self.machine, now) > due or self.programs.only_waits(thread)
            for thread in self.programs.started
        )

    def resume_waiting(self, now: int) -> None:
        """Resume those whose condition is fulfilled."""
        for thread in self.programs.started:
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
            self.machine.schedule.set_alarm()
        while not self.busy:
            port, thread = self._choose_next()
            if port is None and thread is None:
                return
            delay_ns = self._delay.draw_ns(program=port is None)
            if not delay_ns:
                self._perform_decoded(port, thread)
                continue
            self._begin_decoding(port, thread, delay_ns)
            self.leeway_ns = self._leeway_ns(port, thread, delay_ns)
            self.machine.schedule.set_alarm()

    def _begin_decoding(self, port: PortSession | None, thread: ProgramThread | None, delay_ns: int) -> None:
        """Begin to decode the next command of a port or a thread."""
        self.busy = True
        self.decoded_ns = self.machine.timebase.after_ns(delay_ns)
        self._decoding = (port, thread)

    def _leeway_ns(self, port: PortSession | None, thread: ProgramThread | None, delay_ns: int) -> int:
        if any(session.queue for session in self.machine.ports.open_ports() if session is not port):
            return 0
        if port is not None:
            # Commands that arrived together are answered together.
            return min(LEEWAY_NS, (len(port.queue) - 1) * delay_ns)
        return LEEWAY_NS if thread is not None and self.programs.only_waits(thread) else 0

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
        has_run = False
        try:
            while thread.line < len(machine.program.lines) and self.programs.only_waits(thread):
                due_ns = self.decoded_ns if self.busy else wake_ns
                if due_ns >= before_ns:
                    break
                timebase.begin_event(due_ns)
                if self.busy:
                    self._cancel_decoding()
                    self.programs.step_thread(thread)
                elif thread.trip is not None and thread.trip.passed(machine, machine.current_sample()):
                    thread.trip, thread.resting = None, False
                else:
                    break
                has_run = True
                if thread.trip is not None:
                    sample_now = machine.current_sample()
                    due = thread.trip.due(machine, sample_now)
                    wake_ns = NEVER_NS if due == inf else timebase.true_ns(int(max(due, sample_now)))
                elif thread.is_ready:
                    self._choose_next()
                    self._begin_decoding(None, thread, self._delay.draw_ns(program=True))
                else:
                    break
            if has_run:
                if self.busy and self.programs.only_waits(thread):
                    self.leeway_ns = LEEWAY_NS
                machine.schedule.discard_schedule()
        finally:
            timebase.end_event()
        return has_run

    def _sole_program(self) -> ProgramThread | None:
        """Return the only active program of the controller, if it only waits and jumps."""
        machine = self.machine
        if len(self.programs.started) != 1:
            return None
        thread = self.programs.started[0]
        if thread.paused or not self.programs.only_waits(thread):
            return None
        if (
            (self.busy and self._decoding != (None, thread))
            or self._delay.is_instant
            or machine.next_event_sample() != inf
        ):
            return None
        if self.programs.trace or self.programs.break_at is not None or machine.events.has_routines:
            return None
        if any(port.queue or port.trip is not None for port in machine.ports.open_ports()):
            return None
        return thread

    def _choose_next(self) -> tuple[PortSession | None, ProgramThread | None]:
        current = self.programs.current
        if self.machine.model.by_trigger_line and current is not None and current.is_ready and current.index:
            return None, current
        self.programs.current = None
        first = self._turn
        ready = [thread for thread in self.programs.started if thread.trip is None and not thread.paused]
        for thread in ready:
            if 0 < first <= thread.number + 1:
                return None, self._take_turn(thread)
        for port in self.machine.ports.open_ports():
            if port.queue and port.trip is None:
                self._turn = 1
                return port, None
        return None, self._take_turn(ready[0]) if ready else None

    def _take_turn(self, thread: ProgramThread) -> ProgramThread:
        self._turn = (thread.number + 2) % (len(self.programs.threads) + 1)
        return thread

    def _perform_decoded(self, port: PortSession | None, thread: ProgramThread | None) -> None:
        if port is not None:
            port.run_next()
        elif thread is not None and thread.is_ready:
            self.programs.step_thread(thread)
