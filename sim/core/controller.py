"""Interface of a simulated controller: bytes on ports, its physical environment, and the ground truth of its motion.

A simulated controller is driven by a `Clock` alone: it never reads another time and never sleeps. It takes bytes
(`PortConnection.receive`, called at the instant when the last of them has arrived at its port), and sends bytes
(`send`, called at the instant when the first of them leaves its port). Cables, with their baud rates and latencies, are
modelled elsewhere. Each simulator is written from the manual alone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NoReturn, Protocol, runtime_checkable

from pydantic import BaseModel

from orchestrator.clock.base import Clock
from orchestrator.link.supply import PowerSupply
from orchestrator.model.errors import TuttiError
from orchestrator.model.fleet import Controller
from sim.core.oscillator import Oscillator

SendBytes = Callable[[bytes], None]
LimitSwitch = Literal["forward", "reverse", "both", "none"]


class PortRefused(TuttiError):
    """The controller rejects this connection (no such port, or no free handle); the message states the reason."""


@dataclass(frozen=True, slots=True)
class FirmwareTiming:
    """Processing time of the firmware. All zero (the default) for test vectors; real fleets give real figures.

    decode_ns: from the end of a command's bytes to its effect and reply.
    spread_ns: a uniform extra delay of 0 to this value, drawn from the controller's seeded generator for each command.
    """

    decode_ns: int = 0
    spread_ns: int = 0


@dataclass(slots=True)
class CommandedMotion:
    """One commanded motion of one axis, in true time, exactly as the profile generator made it.

    start_ns: the time origin of the profile.
    end_ns: its last commanded change; None while it runs.
    slowing_ns: when the profile generator began to slow down because of a stop (a command, a limit); None without one.
    Positions are in the make's own counts.
    """

    axis: str
    start_ns: int
    start_counts: float
    end_ns: int | None = None
    end_counts: float | None = None
    slowing_ns: int | None = None


class PortConnection(Protocol):
    """One open connection to one port of the controller."""

    @property
    def supply(self) -> PowerSupply:
        """Power supply of the device that owns this port. Loss of power cuts off its output; without power the
        connection closes if the port does so."""
        ...

    def receive_bytes(self, data: bytes) -> None:
        """Process `data`, which arrives now."""
        ...

    def close(self) -> None:
        """Handle the disconnection of the other end."""
        ...


def refuse_analog(number: int, present: str = "no analogue inputs") -> NoReturn:
    """Raise the `ValueError` of `SimulatedController.set_analog`. present: the inputs that there are."""
    raise ValueError(f"no analogue input {number}; this controller has {present}")


class SimulatedController(Protocol):
    """A controller in its physical environment. Axis names are the make's own (`X`, `Y`, … or `1`, `2`, …)."""

    @property
    def port_names(self) -> tuple[str, ...]:
        """Names of the ports that `connect` accepts, e.g. `("tcp", "serial")`; the first one is the default."""
        ...

    @property
    def axis_names(self) -> tuple[str, ...]: ...

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> PortConnection:
        """Open a port. `send` receives the bytes that the controller emits; `closed` is called when the controller
        disconnects.

        Raises `PortRefused`.
        """
        ...

    # Physical environment, changed from outside at the present instant.

    def set_power(self, *, on: bool) -> None:
        """Switch the power. Off: motion stops dead, connections drop, volatile state is lost. On: power-up as in the
        manual."""
        ...

    def set_input(self, number: int, *, level: bool) -> None: ...

    def set_analog(self, number: int, volts: float) -> None:
        """Set the voltage at an analogue input, numbered like the digital inputs. Raises `ValueError` for one that the
        controller does not have."""
        ...

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        """Press limit switches of the axis from outside, independent of its travel; `none` restores the travel's own
        state."""
        ...

    def set_stalled(self, axis: str, *, stalled: bool) -> None:
        """Stall or free an axis. A stalled axis does not follow its command."""
        ...

    def push_axis(self, axis: str, counts: int) -> None:
        """Move an unpowered axis by hand, by `counts` (motor steps where a make has units).

        An encoder detects it; a make that only counts its own motor steps does not. Raises `ValueError` when the motor
        keeps torque on the axis.
        """
        ...

    def output_level(self, number: int) -> bool: ...

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        """Call `listener(number, level)` on every change of an output."""
        ...

    # Ground truth, for tests and verdicts; not visible to clients.

    def position(self, axis: str) -> float:
        """Commanded position now, in counts of the make."""
        ...

    def physical_position(self, axis: str) -> float:
        """Physical position of the axis in counts from where it was built: independent of the position register and of
        power cycles."""
        ...

    def velocity(self, axis: str) -> float:
        """Commanded velocity now, in counts per true second."""
        ...

    def is_moving(self, axis: str) -> bool:
        """Return whether the profile generator commands motion now."""
        ...

    def at_rest(self) -> bool:
        """Return whether no axis moves, no program runs, and nothing queued would move by itself."""
        ...

    @property
    def commanded_motions(self) -> Sequence[CommandedMotion]:
        """Every commanded motion since construction, in order of start (power cycles included)."""
        ...


class Simulator(Protocol):
    """One model that can be simulated: the object that an entry point of group `tutti.simulators` refers to."""

    @property
    def model(self) -> str: ...

    def build_controller(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> SimulatedController:
        """Build a powered-up controller. `options` are the model's own; `ValueError` names a wrong one and lists the
        allowed ones."""
        ...

    @property
    def options_model(self) -> type[BaseModel]:
        """The model of `simulate.options` in the fleet file."""
        ...

    def make_options(self, config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
        """The options with which it fits a controller's part of a fleet file. expected: the options of the adapter,
        defaults included, by name."""
        ...

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> "VectorBench":
        """Build the same controller, ideal in time, with the handles that test vectors need."""
        ...


@dataclass(frozen=True, slots=True)
class DeviceSpec:
    """One device to be built, with the fields of `Simulator.build`.

    address: on the line that it shares; None when it has its own line."""

    address: int | None
    options: Mapping[str, object]
    oscillator: Oscillator
    timing: FirmwareTiming
    seed: int


class LineEndpoint(Protocol):
    """End point of a cable: a controller, or a line that several share."""

    @property
    def port_names(self) -> tuple[str, ...]: ...

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> PortConnection:
        """Open a port. Raises `PortRefused`."""
        ...


@runtime_checkable
class SharingSimulator(Protocol):
    """A `Simulator` of a model whose devices can share a line, addressed one by one."""

    def build_shared(
        self, clock: Clock, devices: Sequence[DeviceSpec]
    ) -> tuple[LineEndpoint, Sequence[SimulatedController]]:
        """Build the line's end point and its powered-up devices, in their order from the host. `ValueError` names a
        wrong option and lists the allowed ones."""
        ...


@dataclass(frozen=True, slots=True)
class SimulatedLine:
    """The far end of a cable.

    units: the devices, by name."""

    endpoint: LineEndpoint
    devices: Mapping[str, SimulatedController]


def build_line(model: Simulator, clock: Clock, devices: Mapping[str, DeviceSpec]) -> SimulatedLine:
    """Build the devices of one line, by name. `ValueError` names a wrong option, or a model that cannot share it."""
    branches = list(devices.values())
    if any(branch.address is not None for branch in branches):
        if not isinstance(model, SharingSimulator):
            raise ValueError(f"controllers of the model {model.model} cannot share a line; give each its own link")
        far_end, controllers = model.build_shared(clock, branches)
        return SimulatedLine(far_end, dict(zip(devices, controllers, strict=True)))
    (name,) = devices
    (spec,) = branches
    controller = model.build_controller(
        clock, spec.options, oscillator=spec.oscillator, timing=spec.timing, seed=spec.seed
    )
    return SimulatedLine(controller, {name: controller})


class VectorBench(Protocol):
    """Interface that the vector runner needs in addition to the controller."""

    @property
    def controller(self) -> SimulatedController: ...

    @property
    def port_name(self) -> str:
        """The port that receives the vector's bytes."""
        ...

    def apply_given(self, state: Mapping[str, object]) -> None:
        """Set up the ground truth of a vector's `given` or of a `setup` step; `ValueError` if unknown."""
        ...

    def is_refusal(self, reply: bytes) -> bool:
        """Return whether `reply` is this make's refusal."""
        ...
