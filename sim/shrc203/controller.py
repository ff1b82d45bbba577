"""The simulated SHRC-203: its serial port, its firmware's pace, and the world around it."""

import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, Timer
from orchestrator.link.supply import Supply
from sim.core.controller import LimitSwitch, Motion, PortRefused, Send, Timing
from sim.core.devicetime import DeviceTime
from sim.core.oscillator import Oscillator
from sim.shrc203.axis import Axis, Phase
from sim.shrc203.commands import answer
from sim.shrc203.inputs import bit
from sim.shrc203.line import CommandLine, LineReader
from sim.shrc203.options import Options
from sim.shrc203.unit import Unit

_END = "\r\n"
_PORT = "serial"


class Port:
    """One open connection to the serial port."""

    def __init__(self, controller: "Shrc203Controller", send: Send, reader: LineReader) -> None:
        self._controller = controller
        self._send = send
        self._open = True
        self.reader = reader
        self.supply = controller.supply

    def receive(self, data: bytes) -> None:
        if self._open:
            self._controller.received(self, data)

    def close(self) -> None:
        self._open = False
        self._controller.closed(self)

    def emit(self, text: str) -> None:
        """Send one line now."""
        if self._open:
            self._send((text + _END).encode("latin-1"))

    def later(self, text: str) -> None:
        """Send a line that no command has asked for just now: completions, COMP, TRIG."""
        self._controller.emit_later(self, text)


@dataclass(slots=True)
class _Pending:
    port: Port
    line: CommandLine


class Shrc203Controller:
    """One unit, from its clock, options, crystal, pace of firmware, and seed."""

    def __init__(
        self,
        clock: Clock,
        options: Options,
        oscillator: Oscillator,
        timing: Timing,
        generator: random.Random,
        scan_phase_ns: int,
    ) -> None:
        self._clock = clock
        self._options = options
        self._timing = timing
        self._generator = generator
        self._time = DeviceTime(clock, oscillator)
        self.unit = Unit(self._time, options, scan_phase_ns)
        self._ports: list[Port] = []
        self._queue: deque[_Pending] = deque()
        self._busy_until_ns = 0
        self._said_until_ns = 0
        self._on = True
        self.supply = Supply()
        self._boot: Timer | None = None
        self._emissions: deque[Timer] = deque()
        self._decoding: deque[Timer] = deque()
        self._replying = False
        self._after_reply: list[tuple[Port, str]] = []
        """Lines caused by the command that is being executed: its own reply comes first."""

    # The wire

    @property
    def ports(self) -> tuple[str, ...]:
        return (_PORT,)

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(axis.name for axis in self.unit.axes)

    def connect(self, port: str, send: Send, closed: Callable[[], None]) -> Port:
        """Open the serial port. A serial line does not hang up, so `closed` is never called."""
        del closed
        if port != _PORT:
            raise PortRefused(f"no port {port!r}; there is {_PORT!r}")
        opened = Port(self, send, LineReader(self._options.line_limit, self._options.cr_only_input))
        self._ports.append(opened)
        return opened

    def closed(self, port: Port) -> None:
        if port in self._ports:
            self._ports.remove(port)

    def received(self, port: Port, data: bytes) -> None:
        """Bytes on the line; nobody listens while the unit is off or restarting."""
        if not self._listening:
            return
        for line in port.reader.lines(data):
            delay_ns = self._delay_ns()
            if not delay_ns and not self._queue:
                self._execute(port, line)
                if not self._listening:
                    return
            else:
                self._queue.append(_Pending(port, line))
                self._busy_until_ns = max(self._clock.now_ns(), self._busy_until_ns) + delay_ns
                self._decoding.append(self._clock.call_at_ns(self._busy_until_ns, self._decoded))

    def emit_later(self, port: Port, text: str) -> None:
        """Asynchronous lines have the same jitter as replies (decision 6), and keep their order."""
        delay_ns = self._delay_ns()
        if not delay_ns:
            if self._replying:
                self._after_reply.append((port, text))
            else:
                port.emit(text)
            return
        self._said_until_ns = max(self._clock.now_ns() + delay_ns, self._said_until_ns)

        def say() -> None:
            self._emissions.popleft()
            port.emit(text)

        self._emissions.append(self._clock.call_at_ns(self._said_until_ns, say))

    @property
    def _listening(self) -> bool:
        return self._on and self._boot is None

    def _delay_ns(self) -> int:
        timing = self._timing
        return timing.decode_ns + (self._generator.randint(0, timing.spread_ns) if timing.spread_ns else 0)

    def _decoded(self) -> None:
        self._decoding.popleft()
        pending = self._queue.popleft()
        self._execute(pending.port, pending.line)

    def _execute(self, port: Port, line: CommandLine) -> None:
        self._replying = True
        text = answer(self.unit, line, port.later)
        self._replying = False
        port.emit(text)
        following, self._after_reply = self._after_reply, []
        for other, late in following:
            other.emit(late)
        if self.unit.restart_due:
            self._restart()

    # Power

    def _silence(self) -> None:
        """Whatever was heard or about to be said is gone."""
        for timer in (*self._decoding, *self._emissions):
            timer.cancel()
        self._decoding.clear()
        self._emissions.clear()
        self._queue.clear()
        for port in self._ports:
            port.reader.clear()

    def _restart(self) -> None:
        self._silence()
        self.unit.power_down()
        self.unit.power_up()
        self._boot = self._time.call_after(round(self._options.reset_s * NS_PER_S), self._booted)

    def _booted(self) -> None:
        self._boot = None

    def set_power(self, on: bool) -> None:
        if on == self._on:
            return
        self._on = on
        self.supply.switched(on, self._clock.now_ns())
        if self._boot is not None:
            self._boot.cancel()
            self._boot = None
        if on:
            self.unit.power_up()
        else:
            self._silence()
            self.unit.power_down()

    # The world

    def _axis(self, name: str) -> Axis:
        for axis in self.unit.axes:
            if axis.name == name:
                return axis
        raise ValueError(f"no axis {name!r}; there are {', '.join(self.axes)}")

    def set_input(self, number: int, level: bool) -> None:
        self.unit.inputs.set(number, level)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        pressed = self._axis(axis)
        pressed.limits = None if which == "none" else which
        pressed.check_limits()
        self._rearm(pressed)

    def set_stalled(self, axis: str, stalled: bool) -> None:
        stuck = self._axis(axis)
        now_ns = self._time.now_ns()
        if stalled and stuck.stalled_at is None:
            stuck.stalled_at = self.unit.drive.followed(stuck, now_ns)
            self._rearm(stuck)
        elif not stalled and stuck.stalled_at is not None:
            # A closed loop catches up; an open one has lost the steps.
            stuck.slip = 0 if stuck.closed_loop else self.unit.drive.position(stuck, now_ns) - stuck.stalled_at
            stuck.stalled_at = None
            self._rearm(stuck)
            if stuck.run is not None:
                self.unit.drive.settle_again(stuck.run)

    def push(self, axis: str, counts: int) -> None:
        """Of a stage whose excitation is off."""
        pushed = self._axis(axis)
        if self._on and pushed.excited:
            raise ValueError(f"axis {axis}: its motor holds it")
        pushed.push(counts)
        pushed.check_limits()

    def _rearm(self, axis: Axis) -> None:
        if axis.run is not None and axis.phase is Phase.MOVING:
            self.unit.drive.rearm(axis.run)

    def output(self, number: int) -> bool:
        return bool(self.unit.outputs.value & bit(number))

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        self.unit.outputs.listeners.append(listener)

    # The truth

    def position(self, axis: str) -> float:
        """The command counter that Q: reports, not rounded to pulses."""
        asked = self._axis(axis)
        return self.unit.drive.exact(asked, self._time.now_ns())[0] + asked.offset

    def place(self, axis: str) -> float:
        return self.unit.drive.exact(self._axis(axis), self._time.now_ns())[0]

    def velocity(self, axis: str) -> float:
        asked = self._axis(axis)
        return self.unit.drive.exact(asked, self._time.now_ns())[1] * self._time.rate()

    def moving(self, axis: str) -> bool:
        asked = self._axis(axis)
        run = asked.run
        if run is None or asked.phase is not Phase.MOVING:
            return False
        return any(track.axis is asked and track.motion is not None for track in run.tracks)

    def at_rest(self) -> bool:
        """Nothing moves, stands by, or is being decoded, and no program runs."""
        idle = not any(axis.busy for axis in self.unit.axes)
        return idle and not self._queue and not self.unit.program.running

    @property
    def motions(self) -> Sequence[Motion]:
        return self.unit.drive.motions


def build_controller(
    clock: Clock, options: Options, oscillator: Oscillator | None, timing: Timing | None, seed: int | None
) -> Shrc203Controller:
    """A powered-up controller; without a seed its input scan is in step with the clock."""
    generator = random.Random(seed or 0)
    scan_phase_ns = 0 if seed is None else generator.randrange(NS_PER_MS)
    return Shrc203Controller(clock, options, oscillator or Oscillator(), timing or Timing(), generator, scan_phase_ns)
