"""The simulated SMC: its ports, its firmware's delays, and its environment."""

import random
from collections.abc import Callable, Sequence

from orchestrator.clock.base import NS_PER_S, Clock, ClockTimer
from orchestrator.link.supply import PowerSupply
from sim.core.controller import CommandedMotion, FirmwareTiming, LimitSwitch, PortRefused, SendBytes, refuse_analog
from sim.core.devicetime import DeviceTime
from sim.core.oscillator import Oscillator
from sim.ppsmc.axis import StepperAxis
from sim.ppsmc.dispatch import execute_line
from sim.ppsmc.line import ClientLine
from sim.ppsmc.machine import StepperHardware
from sim.ppsmc.options import PpsmcOptions
from sim.ppsmc.port import ClientConnection
from sim.ppsmc.unit import ControlProgram, RestartKind

_PORTS = ("tcp", "serial")


class PpsmcController:
    """One controller, from its clock, options, oscillator, firmware timing, and random generator.

    Positions are in the unit of the axis (mm, deg), as the make reports them; inputs and outputs are bits 0-7.
    """

    def __init__(
        self,
        clock: Clock,
        options: PpsmcOptions,
        oscillator: Oscillator,
        timing: FirmwareTiming,
        generator: random.Random,
    ) -> None:
        self._options = options
        self._timing = timing
        self._generator = generator
        self.time = DeviceTime(clock, oscillator)
        self.machine = StepperHardware(self.time, options, generator)
        self.unit = ControlProgram(self.machine, options)
        self._ports: list[ClientConnection] = []
        self._on = True
        self.supply = PowerSupply()
        self._boot: ClockTimer | None = None
        self._deaf = False
        """Reset or restarting: received bytes are ignored."""
        self._refusing = False
        """Off, shut down or restarting: connections are rejected."""

    # Ports

    @property
    def port_names(self) -> tuple[str, ...]:
        return _PORTS

    @property
    def axis_names(self) -> tuple[str, ...]:
        return tuple(axis.name for axis in self.machine.axes)

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> ClientConnection:
        """Open a connection; TCP begins with a greeting (decision 1)."""
        if port not in _PORTS:
            raise PortRefused(f"no port {port!r}; there are {', '.join(_PORTS)}")
        serial = port == "serial"
        if not serial and self._refusing:
            raise PortRefused("the controller is off or restarting")
        if (
            not serial
            and sum(other_port.is_open and not other_port.is_serial for other_port in self._ports)
            >= self._options.max_clients
        ):
            raise PortRefused(f"{self._options.max_clients} clients are connected already; close one first")
        opened_connection = ClientConnection(self, send, closed, serial=serial, limit=self._options.line_limit)
        self._ports.append(opened_connection)
        if not serial and self._options.greeting:
            opened_connection.send_reply(self.unit.firmware_version)
        return opened_connection

    @property
    def is_listening(self) -> bool:
        return not self._deaf

    def delay_ns(self) -> int:
        timing = self._timing
        return timing.decode_ns + (self._generator.randint(0, timing.spread_ns) if timing.spread_ns else 0)

    def frame_reply(self, text: str, *, serial: bool) -> bytes:
        return self.unit.frame_reply(text, serial=serial)

    def handle_disconnect(self, port: ClientConnection) -> None:
        self.unit.forget_client(port)
        if port in self._ports and port.is_empty:
            self._ports.remove(port)

    def execute_line(self, port: ClientConnection, line: ClientLine) -> None:
        unit = self.unit
        execute_line(unit, port, line.text, whole=line.whole)
        if unit.buffers_due:
            unit.buffers_due = False
            for other_port in self._ports:
                if other_port is not port:
                    other_port.discard_waiting()
        if unit.restart_due is not None:
            restart, unit.restart_due = unit.restart_due, None
            self._begin_restart(restart)

    # Power

    def _discard_traffic(self, *, hang_up: bool) -> None:
        for port in list(self._ports):
            port.discard_commands()
            if hang_up and not port.is_serial:
                port.close_from_controller()
                self._ports.remove(port)

    def _begin_restart(self, restart: RestartKind) -> None:
        if restart is RestartKind.SHUTDOWN:
            self.unit.disk.positions = [self.machine.drive.step_counter(axis) for axis in self.machine.axes]
        self.unit.halt_all()
        self._discard_traffic(hang_up=restart is not RestartKind.RESET)
        self._deaf = True
        self._refusing = restart is not RestartKind.RESET
        if restart is not RestartKind.SHUTDOWN:
            self.unit.power_up()
            seconds = self._options.reset_s if restart is RestartKind.RESET else self._options.restart_s
            self._boot = self.time.call_after(round(seconds * NS_PER_S), self._finish_boot)

    def _finish_boot(self) -> None:
        self._boot = None
        self._deaf = self._refusing = False

    def set_power(self, *, on: bool) -> None:
        """Switch the power. Off: motion stops dead and connections drop. On: the power-on state, at once."""
        if on == self._on:
            return
        self._on = on
        self.supply.set_power(on=on, at_ns=self.time.clock.now_ns())
        if self._boot is not None:
            self._boot.cancel()
            self._boot = None
        if on:
            self.unit.power_up()
        else:
            self.unit.halt_all()
            self._discard_traffic(hang_up=True)
        self._deaf = self._refusing = not on

    # Environment

    def find_axis(self, name: str) -> StepperAxis:
        """Return an axis by name; `ValueError` lists the known ones."""
        for axis in self.machine.axes:
            if axis.name == name:
                return axis
        raise ValueError(f"no axis {name!r}; there are {', '.join(self.axis_names)}")

    def set_input(self, number: int, *, level: bool) -> None:
        self.machine.set_input(_bit_mask(number), level=level)

    def set_analog(self, number: int, volts: float) -> None:
        """Raise `ValueError`: there are no analogue inputs."""
        refuse_analog(number)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        self.machine.set_limit(self.find_axis(axis), which)

    def set_stalled(self, axis: str, *, stalled: bool) -> None:
        self.machine.set_stalled(self.find_axis(axis), stalled=stalled)

    def push_axis(self, axis: str, counts: int) -> None:
        """Push an axis at rest, by motor steps: its encoder detects it, its step counter does not."""
        pushed_axis = self.find_axis(axis)
        if pushed_axis.run is not None:
            raise ValueError(f"axis {axis}: its motor keeps torque; push it at rest only")
        pushed_axis.origin -= counts

    def output_level(self, number: int) -> bool:
        return bool(self.machine.output_byte >> _bit_mask(number) & 1)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        self.machine.listeners.append(listener)

    # Ground truth

    def position(self, axis: str) -> float:
        found_axis = self.find_axis(axis)
        drive = self.machine.drive
        return drive.to_coordinate(found_axis, drive.exact_state(found_axis)[0])

    def physical_position(self, axis: str) -> float:
        found_axis = self.find_axis(axis)
        drive = self.machine.drive
        return drive.to_coordinate(found_axis, drive.exact_state(found_axis)[0] - found_axis.origin)

    def velocity(self, axis: str) -> float:
        found_axis = self.find_axis(axis)
        drive = self.machine.drive
        return drive.to_coordinate(found_axis, drive.exact_state(found_axis)[1]) * self.time.clock_rate()

    def is_moving(self, axis: str) -> bool:
        run = self.find_axis(axis).run
        return run is not None and run.start_ns <= self.time.now_ns()

    def at_rest(self) -> bool:
        """Return whether nothing moves or settles, no program runs, and no command waits for its execution."""
        is_still = self.machine.is_still and not self.unit.runner.is_running
        return is_still and all(port.is_empty for port in self._ports)

    @property
    def commanded_motions(self) -> Sequence[CommandedMotion]:
        return self.machine.drive.motions


def _bit_mask(number: int) -> int:
    if not 0 <= number <= 7:
        raise ValueError(f"no i/o bit {number}; there are 0 to 7")
    return number


def build_controller(
    clock: Clock, options: PpsmcOptions, oscillator: Oscillator | None, timing: FirmwareTiming | None, seed: int
) -> PpsmcController:
    """Build a powered-up controller."""
    return PpsmcController(clock, options, oscillator or Oscillator(), timing or FirmwareTiming(), random.Random(seed))
