"""The light controller in its environment: power, connections, and the ground truth of its motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NoReturn

from orchestrator.clock.base import Clock
from orchestrator.link.supply import PowerSupply
from sim.core.controller import CommandedMotion, LimitSwitch, PortRefused, SendBytes, refuse_analog
from sim.core.oscillator import Oscillator
from sim.light.machine import LightMachine


class LightController:
    """A light controller as `SimulatedController`."""

    def __init__(self, clock: Clock, axes: Sequence[str], oscillator: Oscillator) -> None:
        self.machine = LightMachine(clock, axes, oscillator)
        self._axes = {axis.name: axis for axis in self.machine.axes}
        self._on = True
        self._supply = PowerSupply()
        self._connections: list[_Connection] = []

    @property
    def port_names(self) -> tuple[str, ...]:
        return ("process",)

    @property
    def axis_names(self) -> tuple[str, ...]:
        return tuple(self._axes)

    @property
    def supply(self) -> PowerSupply:
        return self._supply

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> "_Connection":
        """Open the port. Raises `PortRefused`."""
        if port not in self.port_names:
            raise PortRefused(f"there is no port {port!r}; there is process")
        if not self._on:
            raise PortRefused("it has no power")
        connection = _Connection(self, send, closed)
        self._connections.append(connection)
        return connection

    def forget(self, connection: "_Connection") -> None:
        """A connection was closed by the other end."""
        if connection in self._connections:
            self._connections.remove(connection)

    def set_power(self, *, on: bool) -> None:
        """Switch the power. Off: motion stops dead, positions are lost, connections drop."""
        if on == self._on:
            return
        self._on = on
        self._supply.set_power(self.machine.time.clock.now_ns(), on=on)
        self.machine.set_power(on=on)
        if on:
            return
        connections, self._connections = self._connections, []
        for connection in connections:
            connection.closed()

    def set_input(self, number: int, *, level: bool) -> None:
        """Raise `ValueError`: it has none."""
        del level
        _refuse(f"no input {number}")

    def set_analog(self, number: int, volts: float) -> None:
        """Raise `ValueError`: it has none."""
        del volts
        refuse_analog(number)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        """Raise `ValueError`: it has no switches."""
        _refuse(f"no limit switch {which} of axis {axis}")

    def set_stalled(self, axis: str, *, stalled: bool) -> None:
        """Raise `ValueError`: its axes follow always."""
        del stalled
        _refuse(f"no stall of axis {axis}")

    def push_axis(self, axis: str, counts: int) -> None:
        """Raise `ValueError`: its axes keep their torque."""
        del counts
        _refuse(f"no push of axis {axis}")

    def output_level(self, number: int) -> bool:
        """Raise `ValueError`: it has none."""
        _refuse(f"no output {number}")

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        """Nothing is ever switched."""
        del listener

    def position(self, axis: str) -> float:
        return self._axes[axis].find_state(self.machine.time.now_ns())[0]

    def physical_position(self, axis: str) -> float:
        return self._axes[axis].physical_position

    def velocity(self, axis: str) -> float:
        time = self.machine.time
        return self._axes[axis].find_state(time.now_ns())[1] * time.clock_rate()

    def is_moving(self, axis: str) -> bool:
        return self._axes[axis].is_moving(self.machine.time.now_ns())

    def at_rest(self) -> bool:
        return not self.machine.is_busy

    @property
    def commanded_motions(self) -> Sequence[CommandedMotion]:
        now_ns = self.machine.time.now_ns()
        for axis in self._axes.values():
            axis.find_state(now_ns)
        return sorted(self.machine.motions, key=lambda motion: motion.start_ns)


@dataclass(eq=False, slots=True)
class _Connection:
    """One connection: each write is one request."""

    controller: LightController
    send: SendBytes
    closed: Callable[[], None]

    @property
    def supply(self) -> PowerSupply:
        return self.controller.supply

    def receive_bytes(self, data: bytes) -> None:
        reply = self.controller.machine.answer(data)
        if reply:
            self.send(reply)

    def close(self) -> None:
        self.controller.forget(self)


def _refuse(what: str) -> NoReturn:
    raise ValueError(f"a light controller has {what}")
