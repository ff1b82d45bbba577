"""The face of a simulated controller: bytes on ports, a physical world around it, and the truth about its motion.

A simulated controller is driven by a `Clock` alone: it never reads another time and never sleeps. It takes
bytes (`Connection.receive`, called at the instant when the last of them has arrived at its port), and sends
bytes (`send`, called at the instant when the first of them leaves its port). Wires, with their baud rates and
latencies, are not its business. It is written from the manual alone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

from orchestrator.clock.base import Clock
from orchestrator.link.supply import Supply
from sim.core.oscillator import Oscillator

Send = Callable[[bytes], None]
LimitSwitch = Literal["forward", "reverse", "both", "none"]


class PortRefused(Exception):
    """The controller does not take this connection (no such port, or no handle is left). Says why."""


@dataclass(frozen=True, slots=True)
class Timing:
    """How long the firmware takes. All zero (the default) for test vectors; real fleets give real figures.

    decode_ns: from the end of a command's bytes to its effect and reply. spread_ns: a uniform extra
    delay of 0 to this much, drawn from the controller's seeded generator for each command.
    """

    decode_ns: int = 0
    spread_ns: int = 0


@dataclass(slots=True)
class Motion:
    """One commanded motion of one axis, in true time, as the profile generator really made it.

    start_ns: the time origin of the profile. end_ns: its last commanded change; None while it runs.
    slowing_ns: when the profile generator began to slow down because of a stop (a command, a limit); None without one.
    Positions are in the make's own counts.
    """

    axis: str
    start_ns: int
    start_counts: float
    end_ns: int | None = None
    end_counts: float | None = None
    slowing_ns: int | None = None


class Connection(Protocol):
    """One open connection to one port of the controller."""

    @property
    def supply(self) -> Supply:
        """Of whoever this port belongs to: power that is lost cuts off what it says. Without, if it hangs up then."""
        ...

    def receive(self, data: bytes) -> None:
        """`data` has arrived, now."""
        ...

    def close(self) -> None:
        """The other side has gone."""
        ...


class SimulatedController(Protocol):
    """A controller in its physical world. Axis names are the make's own (`X`, `Y`, … or `1`, `2`, …)."""

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the ports that `connect` takes, e.g. `("tcp", "serial")`; the first one is the usual one."""
        ...

    @property
    def axes(self) -> tuple[str, ...]: ...

    def connect(self, port: str, send: Send, closed: Callable[[], None]) -> Connection:
        """Open a port. `send` takes what the controller emits; `closed` is called when the controller hangs up.

        Raises `PortRefused`.
        """
        ...

    # The physical world, changed from outside at the present instant.

    def set_power(self, on: bool) -> None:
        """Off: motion stops dead, connections drop, volatile state is lost. On: power-up as the manual says."""
        ...

    def set_input(self, number: int, level: bool) -> None: ...

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        """Which limit switches of the axis are pressed from outside, whatever its travel says; with `none` that holds
        again."""
        ...

    def set_stalled(self, axis: str, stalled: bool) -> None:
        """A stalled axis does not follow its command."""
        ...

    def push(self, axis: str, counts: int) -> None:
        """Somebody moves an axis that nothing holds by hand, by so many counts (motor steps where a make has units).

        An encoder sees it; where the motor's own steps are all that is counted, nobody does. Raises `ValueError` when
        the motor holds the axis.
        """
        ...

    def output(self, number: int) -> bool: ...

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        """Call `listener(number, level)` whenever an output changes."""
        ...

    # The truth, for tests and verdicts; no client of the wire can see it.

    def position(self, axis: str) -> float:
        """Commanded position now, in counts of the make."""
        ...

    def place(self, axis: str) -> float:
        """Where the axis stands in the world, in counts from where it was built: the same whatever its position is
        called, and after a power cycle."""
        ...

    def velocity(self, axis: str) -> float:
        """Commanded velocity now, in counts per true second."""
        ...

    def moving(self, axis: str) -> bool:
        """Whether the profile generator commands motion now."""
        ...

    def at_rest(self) -> bool:
        """No axis moves, no program runs, nothing is queued that would move by itself."""
        ...

    @property
    def motions(self) -> Sequence[Motion]:
        """Every commanded motion since it was built, in order of start (power cycles included)."""
        ...


class Simulator(Protocol):
    """One model that can be simulated: what the entry points of group `tutti.simulators` name."""

    @property
    def model(self) -> str: ...

    def build(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: Timing | None = None,
        seed: int = 0,
    ) -> SimulatedController:
        """A powered-up controller. `options` are the model's own; `ValueError` names a wrong one, and the allowed."""
        ...

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> "VectorBench":
        """The same, ideal in time, with the handles that test vectors need."""
        ...


@dataclass(frozen=True, slots=True)
class Branch:
    """One unit to be built, with the fields of `Simulator.build`. address: on the line that it shares, None when it has
    one for itself."""

    address: int | None
    options: Mapping[str, object]
    oscillator: Oscillator
    timing: Timing
    seed: int


class Port(Protocol):
    """Where a wire ends: a controller, or a line that several share."""

    @property
    def ports(self) -> tuple[str, ...]: ...

    def connect(self, port: str, send: Send, closed: Callable[[], None]) -> Connection:
        """Raises `PortRefused`."""
        ...


@runtime_checkable
class SharingSimulator(Protocol):
    """A `Simulator` of a model whose units can share a line, addressed one by one."""

    def build_shared(self, clock: Clock, units: Sequence[Branch]) -> tuple[Port, Sequence[SimulatedController]]:
        """The line's end, and the powered-up units on it, in their order from the host. `ValueError` names a wrong
        option, and the allowed."""
        ...


@dataclass(frozen=True, slots=True)
class SimulatedLine:
    """What is at the far end of a wire. units: by name."""

    far: Port
    units: Mapping[str, SimulatedController]


def build_line(model: Simulator, clock: Clock, units: Mapping[str, Branch]) -> SimulatedLine:
    """The units of one line, by their names. `ValueError` names a wrong option, or a model that can not share."""
    branches = list(units.values())
    if any(branch.address is not None for branch in branches):
        if not isinstance(model, SharingSimulator):
            raise ValueError(f"units of the model {model.model} can not share a line")
        far, built = model.build_shared(clock, branches)
        return SimulatedLine(far, dict(zip(units, built, strict=True)))
    (name,) = units
    (one,) = branches
    alone = model.build(clock, one.options, oscillator=one.oscillator, timing=one.timing, seed=one.seed)
    return SimulatedLine(alone, {name: alone})


class VectorBench(Protocol):
    """What the vector runner needs beyond the controller itself."""

    @property
    def controller(self) -> SimulatedController: ...

    @property
    def port(self) -> str:
        """The port that the vector's bytes go to."""
        ...

    def given(self, truth: Mapping[str, object]) -> None:
        """Bring about the physical truth of a vector's `given` or of a `setup` step; `ValueError` if unknown."""
        ...

    def refused(self, reply: bytes) -> bool:
        """Whether `reply` is this make's refusal."""
        ...
