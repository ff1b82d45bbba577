"""The simulated SMC: its ports, its firmware's pace, and the world around it."""

import random
from collections.abc import Callable, Sequence

from orchestrator.clock.base import NS_PER_S, Clock, Timer
from orchestrator.link.supply import Supply
from sim.core.controller import LimitSwitch, Motion, PortRefused, Send, Timing
from sim.core.devicetime import DeviceTime
from sim.core.oscillator import Oscillator
from sim.ppsmc.axis import Axis
from sim.ppsmc.dispatch import execute
from sim.ppsmc.line import CommandLine
from sim.ppsmc.machine import Machine
from sim.ppsmc.options import Options
from sim.ppsmc.port import Port
from sim.ppsmc.unit import Restart, Unit

_PORTS = ("tcp", "serial")


class SmcController:
    """One unit, from its clock, options, crystal, pace of firmware, and seed.

    Positions are in the unit of the axis (mm, deg), as the make reports them; inputs and outputs are bits 0-7.
    """

    def __init__(
        self, clock: Clock, options: Options, oscillator: Oscillator, timing: Timing, generator: random.Random
    ) -> None:
        self._options = options
        self._timing = timing
        self._generator = generator
        self.time = DeviceTime(clock, oscillator)
        self.machine = Machine(self.time, options, generator)
        self.unit = Unit(self.machine, options)
        self._ports: list[Port] = []
        self._on = True
        self.supply = Supply()
        self._boot: Timer | None = None
        self._deaf = False
        """Reset or restarting: nobody listens."""
        self._refusing = False
        """Off, shut down or restarting: no connection is taken."""

    # The wire

    @property
    def ports(self) -> tuple[str, ...]:
        return _PORTS

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(axis.name for axis in self.machine.axes)

    def connect(self, port: str, send: Send, closed: Callable[[], None]) -> Port:
        """Open a connection; TCP begins with a greeting (decision 1)."""
        if port not in _PORTS:
            raise PortRefused(f"no port {port!r}; there are {', '.join(_PORTS)}")
        serial = port == "serial"
        if not serial and self._refusing:
            raise PortRefused("the controller is off or restarting")
        if not serial and sum(other.open and not other.serial for other in self._ports) >= self._options.max_clients:
            raise PortRefused(f"{self._options.max_clients} clients are connected already")
        opened = Port(self, send, closed, serial, self._options.line_limit)
        self._ports.append(opened)
        if not serial and self._options.greeting:
            opened.say(self.unit.version)
        return opened

    @property
    def listening(self) -> bool:
        return not self._deaf

    def delay_ns(self) -> int:
        timing = self._timing
        return timing.decode_ns + (self._generator.randint(0, timing.spread_ns) if timing.spread_ns else 0)

    def framed(self, text: str, serial: bool) -> bytes:
        return self.unit.framed(text, serial)

    def left(self, port: Port) -> None:
        self.unit.forget_client(port)
        if port in self._ports and port.empty:
            self._ports.remove(port)

    def execute(self, port: Port, line: CommandLine) -> None:
        unit = self.unit
        execute(unit, port, line.text, line.whole)
        if unit.buffers_due:
            unit.buffers_due = False
            for other in self._ports:
                if other is not port:
                    other.drop_waiting()
        if unit.restart_due is not None:
            restart, unit.restart_due = unit.restart_due, None
            self._restart(restart)

    # Power

    def _silence(self, hang_up: bool) -> None:
        for port in list(self._ports):
            port.drop_commands()
            if hang_up and not port.serial:
                port.hang_up()
                self._ports.remove(port)

    def _restart(self, restart: Restart) -> None:
        if restart is Restart.SHUTDOWN:
            self.unit.disk.positions = [self.machine.drive.counter(axis) for axis in self.machine.axes]
        self.unit.halt()
        self._silence(restart is not Restart.RESET)
        self._deaf = True
        self._refusing = restart is not Restart.RESET
        if restart is not Restart.SHUTDOWN:
            self.unit.power_up()
            seconds = self._options.reset_s if restart is Restart.RESET else self._options.restart_s
            self._boot = self.time.call_after(round(seconds * NS_PER_S), self._booted)

    def _booted(self) -> None:
        self._boot = None
        self._deaf = self._refusing = False

    def set_power(self, on: bool) -> None:
        """Off: motion stops dead and connections drop. On: the power-on state, at once."""
        if on == self._on:
            return
        self._on = on
        self.supply.switched(on, self.time.clock.now_ns())
        if self._boot is not None:
            self._boot.cancel()
            self._boot = None
        if on:
            self.unit.power_up()
        else:
            self.unit.halt()
            self._silence(True)
        self._deaf = self._refusing = not on

    # The world

    def axis(self, name: str) -> Axis:
        """Axis by name; `ValueError` lists the known ones."""
        for axis in self.machine.axes:
            if axis.name == name:
                return axis
        raise ValueError(f"no axis {name!r}; there are {', '.join(self.axes)}")

    def set_input(self, number: int, level: bool) -> None:
        self.machine.set_input(_bit(number), level)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        self.machine.set_limit(self.axis(axis), which)

    def set_stalled(self, axis: str, stalled: bool) -> None:
        self.machine.set_stalled(self.axis(axis), stalled)

    def push(self, axis: str, counts: int) -> None:
        """Of an axis at rest, by motor steps: its encoder sees it, its step counter does not."""
        pushed = self.axis(axis)
        if pushed.run is not None:
            raise ValueError(f"axis {axis}: its motor holds it")
        pushed.origin -= counts

    def output(self, number: int) -> bool:
        return bool(self.machine.outputs >> _bit(number) & 1)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        self.machine.listeners.append(listener)

    # The truth

    def position(self, axis: str) -> float:
        asked = self.axis(axis)
        drive = self.machine.drive
        return drive.coordinate(asked, drive.exact(asked)[0])

    def place(self, axis: str) -> float:
        asked = self.axis(axis)
        drive = self.machine.drive
        return drive.coordinate(asked, drive.exact(asked)[0] - asked.origin)

    def velocity(self, axis: str) -> float:
        asked = self.axis(axis)
        drive = self.machine.drive
        return drive.coordinate(asked, drive.exact(asked)[1]) * self.time.rate()

    def moving(self, axis: str) -> bool:
        run = self.axis(axis).run
        return run is not None and run.start_ns <= self.time.now_ns()

    def at_rest(self) -> bool:
        """Nothing moves or settles, no program runs, and no command waits for its execution."""
        still = self.machine.still and not self.unit.runner.running
        return still and all(port.empty for port in self._ports)

    @property
    def motions(self) -> Sequence[Motion]:
        return self.machine.drive.motions


def _bit(number: int) -> int:
    if not 0 <= number <= 7:
        raise ValueError(f"no i/o bit {number}; there are 0 to 7")
    return number


def build_controller(
    clock: Clock, options: Options, oscillator: Oscillator | None, timing: Timing | None, seed: int
) -> SmcController:
    """A powered-up controller."""
    return SmcController(clock, options, oscillator or Oscillator(), timing or Timing(), random.Random(seed))
