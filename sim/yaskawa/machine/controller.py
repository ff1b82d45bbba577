"""Interface of a simulated controller of the family: ports, environment, and the ground truth of its motion."""

from collections.abc import Callable, Mapping, Sequence

from sim.core.controller import CommandedMotion, LimitSwitch, PortConnection, SendBytes, refuse_analog
from sim.yaskawa.io.network import DeviceNetwork
from sim.yaskawa.language.arguments import canonical_axis
from sim.yaskawa.machine.core import ControllerCore
from sim.yaskawa.motion.axis import ServoAxis

_LIMITS: dict[str, LimitSwitch] = {"forward": "forward", "reverse": "reverse", "both": "both", "none": "none"}


class YaskawaController:
    """Implements `SimulatedController` on a machine."""

    def __init__(self, machine: ControllerCore, ports: tuple[str, ...]) -> None:
        self.machine = machine
        self._ports = ports

    @property
    def port_names(self) -> tuple[str, ...]:
        return self._ports

    @property
    def axis_names(self) -> tuple[str, ...]:
        return tuple(self.machine.letters)

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> PortConnection:
        """Open a port; raises `PortRefused`."""
        return self.machine.ports.connect(port, send, closed)

    def join_network(self, network: DeviceNetwork) -> None:
        """Connect Ethernet: join `network` at the own IP address, and find the other devices there. SMC-4000 only."""
        self.machine.network = network
        network.places[self.machine.address] = self

    def set_power(self, *, on: bool) -> None:
        self.machine.set_power(on=on)

    def set_input(self, number: int, *, level: bool) -> None:
        """Change the terminal of a local input, 1 to 8; True is high."""
        self.machine.signals.set_input(number, level=level)

    def set_analog(self, number: int, volts: float) -> None:
        analog = self.machine.environment.analog
        if not 1 <= number <= len(analog):
            refuse_analog(number, *([f"1 to {len(analog)}"] if analog else []))
        self.machine.advance_to_now()
        analog[number - 1] = volts
        self.machine.run_ready()

    def set_abort(self, *, active: bool) -> None:
        """The abort input (L8030)."""
        self.machine.signals.set_abort_input(active=active)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        machine = self.machine
        machine.advance_to_now()
        limits, name = machine.environment.limits, self._find_axis(axis).name
        if which == "none":
            limits.pop(name, None)
        else:
            limits[name] = which
        machine.signals.limits_changed()
        machine.run_ready()

    def set_home(self, axis: str, *, level: bool) -> None:
        """The home input of an axis; True is high."""
        machine = self.machine
        machine.advance_to_now()
        found_axis = self._find_axis(axis)
        has_changed = (
            machine.environment.home_level(found_axis.name, found_axis.physical_at(machine.current_sample())) != level
        )
        machine.environment.home[found_axis.name] = level
        if has_changed:
            machine.motion.homing.input_changed(found_axis, machine.timebase.next_sample())
        machine.run_ready()

    def set_stalled(self, axis: str, *, stalled: bool) -> None:
        machine = self.machine
        machine.advance_to_now()
        found_axis = self._find_axis(axis)
        found_axis.stalled = stalled
        if stalled:
            found_axis.freeze_motor(machine.current_sample())
        else:
            found_axis.thaw_motor()
        machine.run_ready()

    def push_axis(self, axis: str, counts: int) -> None:
        """Push an axis. A servo's encoder detects it; a stepper counts its own steps, and its encoder is not
        modelled (L14141)."""
        machine = self.machine
        machine.advance_to_now()
        found_axis = self._find_axis(axis)
        if found_axis.frozen is None or found_axis.stalled:
            raise ValueError(f"axis {axis}: its motor keeps torque, or it is stuck; switch the motor off first")
        if found_axis.is_stepper:
            found_axis.physical_zero -= counts
        else:
            found_axis.frozen += counts
        machine.run_ready()

    def output_level(self, number: int) -> bool:
        """Level at the terminal of an output."""
        return self.machine.io.terminals.level(number)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        self.machine.io.listeners.append(listener)

    def position(self, axis: str) -> float:
        """Commanded position now, in counts: on the profile while it moves, a whole count at rest."""
        machine = self.machine
        machine.advance_to_now()
        found_axis, instant = self._find_axis(axis), machine.timebase.current_instant()
        if found_axis.modulus or found_axis.turned is not None or found_axis.command_velocity(instant) == 0.0:
            return float(found_axis.report_counts(found_axis.reference_at(machine.current_sample())))
        return found_axis.command_at(instant)

    def physical_position(self, axis: str) -> float:
        self.machine.advance_to_now()
        return self._find_axis(axis).physical_between(self.machine.timebase.current_instant())

    def velocity(self, axis: str) -> float:
        """Commanded velocity, counts per true second."""
        machine = self.machine
        machine.advance_to_now()
        return (
            self._find_axis(axis).command_velocity(machine.timebase.current_instant()) * machine.timebase.sample_rate()
        )

    def is_moving(self, axis: str) -> bool:
        machine = self.machine
        machine.advance_to_now()
        found_axis = self._find_axis(axis)
        return found_axis.is_moving or found_axis.command_velocity(machine.current_sample()) != 0.0

    def at_rest(self) -> bool:
        machine = self.machine
        machine.advance_to_now()
        return not (
            machine.motion.is_active()
            or machine.programs.any_running()
            or machine.interpreter.busy
            or any(port.queue or port.trip is not None for port in machine.ports.open_ports())
        )

    @property
    def commanded_motions(self) -> Sequence[CommandedMotion]:
        self.machine.advance_to_now()
        return self.machine.motion.record.motions

    def _find_axis(self, name: str) -> ServoAxis:
        return self.machine.motion.axes[canonical_axis(name)]


def is_refusal(reply: bytes) -> bool:
    """Return whether a reply is a refusal: `?`, with or without CR LF (D1)."""
    return reply.rstrip(b"\r\n").endswith(b"?")


class YaskawaBench:
    """Implements `VectorBench`."""

    def __init__(self, controller: YaskawaController) -> None:
        self._controller = controller

    @property
    def controller(self) -> YaskawaController:
        return self._controller

    @property
    def port_name(self) -> str:
        return self._controller.port_names[0]

    def is_refusal(self, reply: bytes) -> bool:
        return is_refusal(reply)

    def apply_given(self, state: Mapping[str, object]) -> None:
        """Set up the ground truth of a vector."""
        for key, value in state.items():
            if isinstance(value, Mapping):
                entries: dict[str, object] = {str(name): item for name, item in value.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
                for name, item in entries.items():
                    self._apply_one(key, name, item)
            elif isinstance(value, Sequence) and not isinstance(value, str | bytes):
                for name in value:  # pyright: ignore[reportUnknownVariableType]
                    self._apply_one(key, str(name), value=True)  # pyright: ignore[reportUnknownArgumentType]
            else:
                raise ValueError(f"{key}: must be a mapping or a list")

    def _apply_one(self, key: str, name: str, value: object) -> None:
        controller, machine = self._controller, self._controller.machine
        if key == "inputs":
            controller.set_input(int(name), level=bool(value))
        elif key == "analog":
            controller.set_analog(int(name), float(str(value)))
        elif key == "outputs":
            machine.io.set_output(int(name), level=bool(value))
        elif key == "limits":
            limits = _LIMITS.get(str(value))
            if limits is None:
                raise ValueError(f"limits: {value!r} is not one of {', '.join(_LIMITS)}")
            controller.set_limit(name, limits)
        elif key == "home":
            controller.set_home(name, level=bool(value))
        elif key == "stalled":
            controller.set_stalled(name, stalled=bool(value))
        elif key == "motor_off":
            axis = machine.motion.axes[canonical_axis(name)]
            machine.motion.freeze_motion(machine.current_sample(), 7, (axis,))
            machine.motion.switch_motor_off(axis, machine.current_sample())
        elif key in ("position", "encoder", "aux_encoder"):
            axis = machine.motion.axes[canonical_axis(name)]
            counts = round(float(str(value)))
            if key == "aux_encoder":
                axis.auxiliary = counts
            else:
                axis.define_position(machine.current_sample(), counts)
        else:
            raise ValueError(f"unknown truth {key!r}")
