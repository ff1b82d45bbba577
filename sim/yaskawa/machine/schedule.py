"""Schedule of one controller: the next event, and the clock's alarm for it."""

from math import inf
from typing import Protocol

from orchestrator.clock.base import ClockTimer
from sim.yaskawa.base.timebase import NEVER_NS, ServoTimebase
from sim.yaskawa.machine.interpreter import LEEWAY_NS, SharedInterpreter


class ScheduledMachine(Protocol):
    """The machine as its schedule drives it."""

    @property
    def timebase(self) -> ServoTimebase: ...

    @property
    def interpreter(self) -> SharedInterpreter: ...

    @property
    def powered(self) -> bool: ...

    def current_sample(self) -> int:
        """Present sample."""
        ...

    def next_event_sample(self) -> float:
        """Return the next sample with an event that no program causes."""
        ...

    def settle_events(self) -> None:
        """Advance motion, recording and trippoints to the present sample."""
        ...

    def run_ready(self) -> None:
        """Run all that is ready."""
        ...


class EventSchedule:
    """Calls the machine at its events, in their order."""

    def __init__(self, machine: ScheduledMachine) -> None:
        self._machine = machine
        self._wake_sample: float = -inf
        """The next sample with an event, as far as it is known."""
        self._wake_ns = NEVER_NS
        self._wake_leeway_ns = 0
        self._alarm: ClockTimer | None = None
        self._alarm_ns = (NEVER_NS, 0)
        """Its due time, and the leeway."""
        self._catching_up = False

    def is_quiet(self, now: int) -> bool:
        """Return whether there is no event up to sample `now`."""
        return now < self._wake_sample

    def forget_wake(self) -> None:
        """Forget the next sample with an event: it is due at another instant."""
        self._wake_ns, self._wake_sample = NEVER_NS, -inf

    def schedule_wake(self) -> None:
        """Schedule a call at the next sample with an event."""
        sample_now = self._machine.current_sample()
        next_sample = self._machine.next_event_sample()
        due = min(next_sample, self._machine.interpreter.next_check(sample_now))
        if due != self._wake_sample:
            self._wake_sample, self._wake_ns, self._wake_leeway_ns = due, NEVER_NS, 0
            if due != inf:
                self._wake_ns = self._machine.timebase.true_ns(int(max(due, sample_now)))
                # Of the due events only a waiting program may be processed later.
                if due < next_sample and self._machine.interpreter.only_waits_at(due, sample_now):
                    self._wake_leeway_ns = LEEWAY_NS
        self.set_alarm()

    def discard_schedule(self) -> None:
        """Discard the schedule after the next event was processed elsewhere."""
        self._wake_sample, self._wake_ns = -inf, NEVER_NS
        self.schedule_wake()

    def set_alarm(self) -> None:
        """Set the alarm for the earliest event: a sample, or a decoded command."""
        if self._catching_up:
            return  # once for all of it
        interpreter = self._machine.interpreter
        due_ns = min(self._wake_ns, interpreter.decoded_ns)
        last_ns = min(self._wake_ns + self._wake_leeway_ns, interpreter.decoded_ns + interpreter.leeway_ns)
        if self._alarm is not None:
            if self._alarm_ns == (due_ns, last_ns):
                return
            self._alarm.cancel()
            self._alarm = None
        if due_ns != NEVER_NS:
            self._alarm_ns = (due_ns, last_ns)
            self._alarm = self._machine.timebase.clock.call_at_ns(due_ns, self._handle_alarm, last_ns - due_ns)

    def catch_up(self) -> None:
        """Process the events due before an input from outside: live, timers are late."""
        now_ns = self._machine.timebase.clock.now_ns()
        if min(self._wake_ns, self._machine.interpreter.decoded_ns) >= now_ns:
            return
        outer, self._catching_up = self._catching_up, True
        try:
            while self._machine.powered and min(self._wake_ns, self._machine.interpreter.decoded_ns) < now_ns:
                if not self._machine.interpreter.poll_alone(self._wake_ns, now_ns):
                    self._process_next()
        finally:
            self._catching_up = outer
        self.set_alarm()

    def _process_next(self) -> None:
        """Process the earliest event."""
        if self._wake_ns <= self._machine.interpreter.decoded_ns:
            self._handle_wake()
        else:
            self._machine.interpreter.run_decoded()

    def _handle_alarm(self) -> None:
        self._alarm = None
        outer, self._catching_up = self._catching_up, True
        try:
            # Earlier events that were allowed to be late have been processed before.
            self.catch_up()
            if (
                self._machine.powered
                and min(self._wake_ns, self._machine.interpreter.decoded_ns) <= self._machine.timebase.clock.now_ns()
            ):
                self._process_next()
            self.catch_up()
        finally:
            self._catching_up = outer
        self.set_alarm()

    def _handle_wake(self) -> None:
        timebase = self._machine.timebase
        timebase.begin_event(self._wake_ns)
        self._wake_ns, self._wake_sample = NEVER_NS, -inf
        try:
            self._machine.settle_events()
            self._machine.run_ready()
        finally:
            timebase.end_event()
