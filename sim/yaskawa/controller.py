"""The face of a simulated controller of the family: ports, the world around it, and the truth about its motion."""

from collections.abc import Callable, Mapping, Sequence

from sim.core.controller import Connection, LimitSwitch, Motion, Send
from sim.yaskawa.language.arguments import canonical
from sim.yaskawa.machine import Machine
from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.ports.network import Network

_LIMITS: dict[str, LimitSwitch] = {"forward": "forward", "reverse": "reverse", "both": "both", "none": "none"}


class Controller:
    """Implements `SimulatedController` on a machine."""

    def __init__(self, machine: Machine, ports: tuple[str, ...]) -> None:
        self.machine = machine
        self._ports = ports

    @property
    def ports(self) -> tuple[str, ...]:
        return self._ports

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(self.machine.letters)

    def connect(self, port: str, send: Send, closed: Callable[[], None]) -> Connection:
        """Open a port; raises `PortRefused`."""
        return self.machine.ports.connect(port, send, closed)

    def join(self, network: Network) -> None:
        """Ethernet: be at the own IP address on `network`, and find the others there. SMC-4000 only."""
        self.machine.network = network
        network.places[self.machine.address] = self

    def set_power(self, on: bool) -> None:
        self.machine.set_power(on)

    def set_input(self, number: int, level: bool) -> None:
        """Local input 1 to 8; True is high."""
        self.machine.set_input(number, level)

    def set_abort(self, active: bool) -> None:
        """The abort input (L8030)."""
        self.machine.set_abort_input(active)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        machine = self.machine
        machine.look()
        limits, name = machine.world.limits, self._axis(axis).name
        if which == "none":
            limits.pop(name, None)
        else:
            limits[name] = which
        machine.limits_changed()
        machine.go_on()

    def set_home(self, axis: str, level: bool) -> None:
        """The home input of an axis; True is high."""
        machine = self.machine
        machine.look()
        found = self._axis(axis)
        changed = machine.world.home_level(found.name, found.physical(machine.now())) != level
        machine.world.home[found.name] = level
        if changed:
            machine.motion.homing.input_changed(found, machine.timebase.next_sample())
        machine.go_on()

    def set_stalled(self, axis: str, stalled: bool) -> None:
        machine = self.machine
        machine.look()
        found = self._axis(axis)
        found.stalled = stalled
        if stalled:
            found.freeze(machine.now())
        else:
            found.thaw()
        machine.go_on()

    def push(self, axis: str, counts: int) -> None:
        """A servo's encoder sees it; a stepper counts its own steps, and its encoder is not modelled (L14141)."""
        machine = self.machine
        machine.look()
        found = self._axis(axis)
        if found.frozen is None or found.stalled:
            raise ValueError(f"axis {axis}: its motor holds it, or it is stuck")
        if found.stepper:
            found.physical_zero -= counts
        else:
            found.frozen += counts
        machine.go_on()

    def output(self, number: int) -> bool:
        return bool(self.machine.io.read_output(number))

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        self.machine.io.listeners.append(listener)

    def position(self, axis: str) -> float:
        """Commanded position now, in counts: on the profile while it moves, a whole count at rest."""
        machine = self.machine
        machine.look()
        found, instant = self._axis(axis), machine.timebase.instant()
        if found.modulus or found.turned is not None or found.command_velocity(instant) == 0.0:
            return float(found.reported(found.reference(machine.now())))
        return found.command(instant)

    def place(self, axis: str) -> float:
        self.machine.look()
        return float(self._axis(axis).physical(self.machine.now()))

    def velocity(self, axis: str) -> float:
        """Commanded velocity, counts per true second."""
        machine = self.machine
        machine.look()
        return self._axis(axis).command_velocity(machine.timebase.instant()) * machine.timebase.sample_rate()

    def moving(self, axis: str) -> bool:
        machine = self.machine
        machine.look()
        found = self._axis(axis)
        return found.moving or found.command_velocity(machine.now()) != 0.0

    def at_rest(self) -> bool:
        machine = self.machine
        machine.look()
        return not (
            machine.motion.active()
            or machine.interpreter.any_running()
            or machine.interpreter.busy
            or any(port.queue or port.trip is not None for port in machine.ports.all())
        )

    @property
    def motions(self) -> Sequence[Motion]:
        self.machine.look()
        return self.machine.motion.motions

    def _axis(self, name: str) -> Axis:
        return self.machine.motion.axes[canonical(name)]


def refused(reply: bytes) -> bool:
    """Whether a reply is a refusal: `?`, with or without CR LF (D1)."""
    return reply.rstrip(b"\r\n").endswith(b"?")


class Bench:
    """Implements `VectorBench`."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    @property
    def controller(self) -> Controller:
        return self._controller

    @property
    def port(self) -> str:
        return self._controller.ports[0]

    def refused(self, reply: bytes) -> bool:
        return refused(reply)

    def given(self, truth: Mapping[str, object]) -> None:
        """Bring about the physical truth of a vector."""
        for key, value in truth.items():
            if isinstance(value, Mapping):
                entries: dict[str, object] = {str(name): item for name, item in value.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
                for name, item in entries.items():
                    self._one(key, name, item)
            elif isinstance(value, Sequence) and not isinstance(value, str | bytes):
                for name in value:  # pyright: ignore[reportUnknownVariableType]
                    self._one(key, str(name), True)  # pyright: ignore[reportUnknownArgumentType]
            else:
                raise ValueError(f"{key}: a mapping or a list is needed")

    def _one(self, key: str, name: str, value: object) -> None:
        controller, machine = self._controller, self._controller.machine
        if key == "inputs":
            controller.set_input(int(name), bool(value))
        elif key == "analog":
            machine.world.analog[int(name) - 1] = float(str(value))
        elif key == "outputs":
            machine.io.set_output(int(name), bool(value))
        elif key == "limits":
            which = _LIMITS.get(str(value))
            if which is None:
                raise ValueError(f"limits: {value!r} is none of {', '.join(_LIMITS)}")
            controller.set_limit(name, which)
        elif key == "home":
            controller.set_home(name, bool(value))
        elif key == "stalled":
            controller.set_stalled(name, bool(value))
        elif key == "motor_off":
            axis = machine.motion.axes[canonical(name)]
            machine.motion.freeze(machine.now(), 7, (axis,))
            machine.motion.motor_off(axis, machine.now())
        elif key in ("position", "encoder", "aux_encoder"):
            axis = machine.motion.axes[canonical(name)]
            counts = round(float(str(value)))
            if key == "aux_encoder":
                axis.auxiliary = counts
            else:
                axis.define(machine.now(), counts)
        else:
            raise ValueError(f"unknown truth {key!r}")
