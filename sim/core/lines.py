"""A simulated controller with text lines and axes that move in trapezoids: ports, power, decoding time, ground truth.

A make derives its own class, with the commands. Counts are those of the make.
"""

import random
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_MS, Clock, ClockTimer
from orchestrator.link.supply import PowerSupply
from sim.core.controller import CommandedMotion, FirmwareTiming, LimitSwitch, PortRefused, SendBytes, refuse_analog
from sim.core.devicetime import DeviceTime
from sim.core.oscillator import Oscillator
from sim.core.trapezoids import TrapezoidAxis


class LinePort:
    """One open connection. What is half received is its own."""

    def __init__(self, controller: "LineController", send: SendBytes, closed: Callable[[], None]) -> None:
        self.supply = controller.supply
        self.send = send
        self.closed = closed
        self._controller = controller

    def receive_bytes(self, data: bytes) -> None:
        self._controller.receive_bytes(self, data)

    def close(self) -> None:
        self._controller.handle_close(self)


@dataclass(frozen=True, slots=True)
class LineFirmware:
    """How the firmware behaves. startup_ms: after power-up it takes nothing for this time. longest_line: characters.

    terminator: ends a command. char_ns: one character on its serial line.
    """

    startup_ms: int = 0
    longest_line: int = 200
    terminator: bytes = b"\n"
    char_ns: int = 86_806


@dataclass(frozen=True, slots=True)
class LineDevice:
    """One device in its time: what `Simulator.build_controller` receives."""

    clock: Clock
    oscillator: Oscillator | None = None
    timing: FirmwareTiming | None = None
    seed: int = 0


class LineController(ABC):
    """One controller with all its axes."""

    port_names: tuple[str, ...] = ("serial",)

    def __init__(self, axes: Sequence[str], device: LineDevice) -> None:
        self.clock = clock = device.clock
        self.time = DeviceTime(clock, device.oscillator or Oscillator())
        self.supply = PowerSupply()
        self.firmware = LineFirmware()
        self.commanded_motions: list[CommandedMotion] = []
        self.axes = {name: TrapezoidAxis(self.time, name, self.commanded_motions, self.handle_rest) for name in axes}
        self.is_on = True
        self._timing = device.timing or FirmwareTiming()
        self._draw = random.Random(device.seed)
        self._ports: list[LinePort] = []
        self._partial: dict[LinePort, bytes] = {}
        self._pending: list[ClockTimer] = []
        self._decoded_ns = 0
        self._deaf_until_ns = 0

    @property
    def axis_names(self) -> tuple[str, ...]:
        return tuple(self.axes)

    # What a make provides

    @abstractmethod
    def handle_line(self, line: str, reply: Callable[[str], None]) -> None:
        """Execute a command line."""

    @abstractmethod
    def reset_volatile(self) -> None:
        """Lose everything that is not stored permanently."""

    def take_immediate(self, data: bytes, reply: Callable[[str], None]) -> bytes:
        """Execute single bytes that act at once, wherever they are; return the others."""
        del reply
        return data

    def handle_rest(self) -> None:
        """An axis has come to rest."""
        return

    def greet(self) -> str:
        """What the controller sends when it has started."""
        return ""

    # Ports

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> LinePort:
        if port not in self.port_names:
            raise PortRefused(f"no port {port!r}; ports: {', '.join(self.port_names)}")
        opened_port = LinePort(self, send, closed)
        self._ports.append(opened_port)
        self._partial[opened_port] = b""
        return opened_port

    def handle_close(self, port: LinePort) -> None:
        if port in self._ports:
            self._ports.remove(port)
            del self._partial[port]

    def receive_bytes(self, port: LinePort, data: bytes) -> None:
        data = self.supply.cut_received(data, self.clock.now_ns(), self.firmware.char_ns)
        if not self.is_on or self.clock.now_ns() < self._deaf_until_ns:
            return
        delay_ns = self._timing.decode_ns
        if self._timing.spread_ns:
            delay_ns += self._draw.randint(0, self._timing.spread_ns)
        if not delay_ns:
            self._take_bytes(port, data)
            return
        self._decoded_ns = max(self._decoded_ns, self.clock.now_ns()) + delay_ns
        self._pending.append(self.clock.call_at_ns(self._decoded_ns, lambda: self._take_bytes(port, data)))
        del self._pending[:-50]

    def _take_bytes(self, port: LinePort, data: bytes) -> None:
        if port not in self._ports or not self.is_on:
            return

        def reply(text: str) -> None:
            self.send_text(port, text)

        remainder = self.take_immediate(data, reply)  # which may empty the buffers
        self._partial[port] += remainder
        while port in self._partial and self.is_on and self.may_parse():
            line, terminator, tail = self._partial[port].partition(self.firmware.terminator)
            if not terminator:
                self._partial[port] = line[-self.firmware.longest_line :]
                return
            self._partial[port] = tail
            self.handle_line(line.decode("latin-1").strip("\r\n "), reply)

    def may_parse(self) -> bool:
        """Return whether lines are taken from the receive buffer now."""
        return True

    def parse_again(self) -> None:
        """Take lines from the receive buffers that waited."""
        for port in list(self._ports):
            self._take_bytes(port, b"")

    def waiting_bytes(self) -> int:
        """Number of bytes in the receive buffers."""
        return sum(len(data) for data in self._partial.values())

    def discard_received(self) -> None:
        """Empty the receive buffers."""
        for port in self._partial:
            self._partial[port] = b""

    def send_text(self, port: LinePort, text: str) -> None:
        if self.is_on and port in self._ports:
            port.send(text.encode("latin-1"))

    def send_to_all(self, text: str) -> None:
        for port in list(self._ports):
            self.send_text(port, text)

    # Environment

    def set_power(self, *, on: bool) -> None:
        if on == self.is_on:
            return
        self.is_on = on
        self.supply.set_power(self.clock.now_ns(), on=on)
        if not on:
            for axis in self.axes.values():
                axis.halt()
            for timer in self._pending:
                timer.cancel()
            self._pending.clear()
            for port in list(self._ports):
                self._partial[port] = b""
            return
        self.reset_volatile()
        for axis in self.axes.values():
            axis.set_position(0.0)
        startup_ns = self.firmware.startup_ms * NS_PER_MS
        self._deaf_until_ns = self.clock.now_ns() + startup_ns
        self._pending.append(self.clock.call_at_ns(self._deaf_until_ns, lambda: self.send_to_all(self.greet())))

    def set_input(self, number: int, *, level: bool) -> None:
        raise ValueError(f"no input {number}; this controller has none")

    def set_analog(self, number: int, volts: float) -> None:
        refuse_analog(number)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        if which != "none":
            self.axes[axis].halt()

    def set_stalled(self, axis: str, *, stalled: bool) -> None:
        """Change nothing: without an encoder the controller reports the position that it commands."""
        del axis, stalled

    def push_axis(self, axis: str, counts: int) -> None:
        raise ValueError(f"the motor of {axis} keeps its torque")

    def output_level(self, number: int) -> bool:
        raise ValueError(f"no output {number}; this controller has none")

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        """Do nothing: there is no output that could change."""
        del listener

    # Ground truth

    def position(self, axis: str) -> float:
        return self.axes[axis].position

    def physical_position(self, axis: str) -> float:
        return self.axes[axis].physical_position

    def velocity(self, axis: str) -> float:
        return self.axes[axis].true_velocity

    def is_moving(self, axis: str) -> bool:
        return self.axes[axis].is_moving

    def at_rest(self) -> bool:
        return not any(axis.is_moving for axis in self.axes.values())
