"""The simulated SHRC-203: its serial port, its firmware's delays, and its environment."""

import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, ClockTimer
from orchestrator.link.supply import PowerSupply
from sim.core.controller import CommandedMotion, FirmwareTiming, LimitSwitch, PortRefused, SendBytes, refuse_analog
from sim.core.devicetime import DeviceTime
from sim.core.oscillator import Oscillator
from sim.shrc203.axis import AxisPhase, StageAxis
from sim.shrc203.commands import answer_line
from sim.shrc203.inputs import bit_mask
from sim.shrc203.line import ReceivedLine, SerialLineReader
from sim.shrc203.options import Shrc203Options
from sim.shrc203.trigger import TRIGGER_LINE
from sim.shrc203.unit import StageSystem

_END = "\r\n"
_PORT = "serial"


class SerialSession:
    """One open connection to the serial port."""

    def __init__(self, controller: "Shrc203Controller", send: SendBytes, reader: SerialLineReader) -> None:
        self._controller = controller
        self._send = send
        self._open = True
        self.reader = reader
        self.supply = controller.supply

    def receive_bytes(self, data: bytes) -> None:
        if self._open:
            self._controller.handle_bytes(self, data)

    def close(self) -> None:
        self._open = False
        self._controller.handle_close(self)

    def emit_line(self, text: str) -> None:
        """Send one line now."""
        if self._open:
            self._send((text + _END).encode("latin-1"))

    def queue_line(self, text: str) -> None:
        """Send a line that is not the reply to a command: completions, COMP, TRIG."""
        self._controller.emit_later(self, text)


@dataclass(slots=True)
class _PendingLine:
    port: SerialSession
    line: ReceivedLine


class Shrc203Controller:
    """One controller, from its clock, options, oscillator, firmware timing, and seed.

    Without a seed its input scan is in step with the clock.
    """

    def __init__(
        self,
        clock: Clock,
        options: Shrc203Options,
        oscillator: Oscillator,
        timing: FirmwareTiming,
        seed: int | None,
    ) -> None:
        generator = random.Random(seed or 0)
        scan_phase_ns = 0 if seed is None else generator.randrange(NS_PER_MS)
        self._clock = clock
        self._options = options
        self._timing = timing
        self._generator = generator
        self._time = DeviceTime(clock, oscillator)
        self.unit = StageSystem(self._time, options, scan_phase_ns)
        self._ports: list[SerialSession] = []
        self._queue: deque[_PendingLine] = deque()
        self._busy_until_ns = 0
        self._sent_until_ns = 0
        self._on = True
        self.supply = PowerSupply()
        self._boot: ClockTimer | None = None
        self._emissions: deque[ClockTimer] = deque()
        self._decoding: deque[ClockTimer] = deque()
        self._replying = False
        self._after_reply: list[tuple[SerialSession, str]] = []
        """Lines caused by the command being executed: its own reply comes first."""

    # Serial line

    @property
    def port_names(self) -> tuple[str, ...]:
        return (_PORT,)

    @property
    def axis_names(self) -> tuple[str, ...]:
        return tuple(axis.name for axis in self.unit.axes)

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> SerialSession:
        """Open the serial port. A serial line does not disconnect, so `closed` is never called."""
        del closed
        if port != _PORT:
            raise PortRefused(f"no port {port!r}; there is {_PORT!r}")
        opened_session = SerialSession(
            self, send, SerialLineReader(self._options.line_limit, self._options.cr_only_input)
        )
        self._ports.append(opened_session)
        return opened_session

    def handle_close(self, port: SerialSession) -> None:
        if port in self._ports:
            self._ports.remove(port)

    def handle_bytes(self, port: SerialSession, data: bytes) -> None:
        """Receive bytes; they are ignored while the controller is off or restarting."""
        if not self._is_listening:
            return
        for line in port.reader.read_lines(data):
            delay_ns = self._delay_ns()
            if not delay_ns and not self._queue:
                self._execute_line(port, line)
                if not self._is_listening:
                    return
            else:
                self._queue.append(_PendingLine(port, line))
                self._busy_until_ns = max(self._clock.now_ns(), self._busy_until_ns) + delay_ns
                self._decoding.append(self._clock.call_at_ns(self._busy_until_ns, self._handle_decoded))

    def emit_later(self, port: SerialSession, text: str) -> None:
        """Send an asynchronous line with the same jitter as replies (decision 6), in order."""
        delay_ns = self._delay_ns()
        if not delay_ns:
            if self._replying:
                self._after_reply.append((port, text))
            else:
                port.emit_line(text)
            return
        self._sent_until_ns = max(self._clock.now_ns() + delay_ns, self._sent_until_ns)

        def send_line() -> None:
            self._emissions.popleft()
            port.emit_line(text)

        self._emissions.append(self._clock.call_at_ns(self._sent_until_ns, send_line))

    @property
    def _is_listening(self) -> bool:
        return self._on and self._boot is None

    def _delay_ns(self) -> int:
        timing = self._timing
        return timing.decode_ns + (self._generator.randint(0, timing.spread_ns) if timing.spread_ns else 0)

    def _handle_decoded(self) -> None:
        self._decoding.popleft()
        pending = self._queue.popleft()
        self._execute_line(pending.port, pending.line)

    def _execute_line(self, port: SerialSession, line: ReceivedLine) -> None:
        self._replying = True
        text = answer_line(self.unit, line, port.queue_line)
        self._replying = False
        port.emit_line(text)
        following, self._after_reply = self._after_reply, []
        for other_session, late in following:
            other_session.emit_line(late)
        if self.unit.restart_due:
            self._restart_firmware()

    # Power

    def _discard_traffic(self) -> None:
        """Discard all bytes received and all lines about to be sent."""
        for timer in (*self._decoding, *self._emissions):
            timer.cancel()
        self._decoding.clear()
        self._emissions.clear()
        self._queue.clear()
        for port in self._ports:
            port.reader.discard_partial()

    def _restart_firmware(self) -> None:
        self._discard_traffic()
        self.unit.power_down()
        self.unit.power_up()
        self._boot = self._time.call_after(round(self._options.reset_s * NS_PER_S), self._finish_boot)

    def _finish_boot(self) -> None:
        self._boot = None

    def set_power(self, *, on: bool) -> None:
        if on == self._on:
            return
        self._on = on
        self.supply.set_power(on=on, at_ns=self._clock.now_ns())
        if self._boot is not None:
            self._boot.cancel()
            self._boot = None
        if on:
            self.unit.power_up()
        else:
            self._discard_traffic()
            self.unit.power_down()

    # Environment

    def _find_axis(self, name: str) -> StageAxis:
        for axis in self.unit.axes:
            if axis.name == name:
                return axis
        raise ValueError(f"no axis {name!r}; there are {', '.join(self.axis_names)}")

    def set_input(self, number: int, *, level: bool) -> None:
        self.unit.inputs.set_level(number, level=level)

    def set_analog(self, number: int, volts: float) -> None:
        """Raise `ValueError`: there are no analogue inputs."""
        refuse_analog(number)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        pressed_axis = self._find_axis(axis)
        pressed_axis.limits = None if which == "none" else which
        pressed_axis.check_limits()
        self._rearm_axis(pressed_axis)

    def set_stalled(self, axis: str, *, stalled: bool) -> None:
        stuck = self._find_axis(axis)
        now_ns = self._time.now_ns()
        if stalled and stuck.stalled_at is None:
            stuck.stalled_at = self.unit.drive.scale_position(stuck, now_ns)
            self._rearm_axis(stuck)
        elif not stalled and stuck.stalled_at is not None:
            # A closed loop catches up; an open one has lost the steps.
            stuck.scale_deviation = (
                0 if stuck.closed_loop else self.unit.drive.output_position(stuck, now_ns) - stuck.stalled_at
            )
            stuck.stalled_at = None
            self._rearm_axis(stuck)
            if stuck.run is not None:
                self.unit.drive.restart_settling(stuck.run)

    def push_axis(self, axis: str, counts: int) -> None:
        """Push a stage whose excitation is off."""
        pushed_axis = self._find_axis(axis)
        if self._on and pushed_axis.excited:
            raise ValueError(f"axis {axis}: its motor keeps torque; switch the excitation off first")
        pushed_axis.push_stage(counts)
        pushed_axis.check_limits()

    def _rearm_axis(self, axis: StageAxis) -> None:
        if axis.run is not None and axis.phase is AxisPhase.MOVING:
            self.unit.drive.rearm_run(axis.run)

    def output_level(self, number: int) -> bool:
        if number == TRIGGER_LINE:
            return self.unit.trigger.level
        return bool(self.unit.outputs.value & bit_mask(number))

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        """OUT1 to OUT6, and the trigger output as number 7."""
        self.unit.outputs.listeners.append(listener)
        self.unit.trigger.listeners.append(listener)

    # Ground truth

    def position(self, axis: str) -> float:
        """The command counter that Q: reports, not rounded to pulses."""
        found_axis = self._find_axis(axis)
        return self.unit.drive.exact_state(found_axis, self._time.now_ns())[0] + found_axis.offset

    def physical_position(self, axis: str) -> float:
        return self.unit.drive.exact_state(self._find_axis(axis), self._time.now_ns())[0]

    def velocity(self, axis: str) -> float:
        found_axis = self._find_axis(axis)
        return self.unit.drive.exact_state(found_axis, self._time.now_ns())[1] * self._time.clock_rate()

    def is_moving(self, axis: str) -> bool:
        found_axis = self._find_axis(axis)
        run = found_axis.run
        if run is None or found_axis.phase is not AxisPhase.MOVING:
            return False
        return any(track.axis is found_axis and track.motion is not None for track in run.tracks)

    def at_rest(self) -> bool:
        """Return whether nothing moves, stands by, or is being decoded, and no program runs."""
        idle = not any(axis.is_busy for axis in self.unit.axes)
        return idle and not self._queue and not self.unit.program.is_running

    @property
    def commanded_motions(self) -> Sequence[CommandedMotion]:
        return self.unit.drive.motions


def build_controller(
    clock: Clock,
    options: Shrc203Options,
    oscillator: Oscillator | None,
    timing: FirmwareTiming | None,
    seed: int | None,
) -> Shrc203Controller:
    """Build a powered-up controller; without a seed its input scan is in step with the clock."""
    return Shrc203Controller(clock, options, oscillator or Oscillator(), timing or FirmwareTiming(), seed)
