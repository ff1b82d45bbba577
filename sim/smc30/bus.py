"""Units that share one serial line as separate controllers of a fleet (L875-L884)."""

import random
from collections.abc import Callable, Mapping, Sequence

from orchestrator.clock.base import Clock
from sim.core.controller import Branch, Connection, LimitSwitch, Motion, Send
from sim.smc30.controller import STOP_INPUT, Place, Smc30Controller, Station
from sim.smc30.inputs import USER_INPUTS
from sim.smc30.options import Options, UnitOptions, read_options
from sim.smc30.outputs import USER_OUTPUTS

_AXIS = "1"
_OF_THE_LINE = tuple(sorted(Options.model_fields.keys() - UnitOptions.model_fields.keys() - {"units"}))


class BusUnit:
    """One unit of a bus; fulfils `SimulatedController`. Its axis is `1`, its inputs are 1-3, and 4 the Stop input."""

    def __init__(self, bus: Smc30Controller, station: Station) -> None:
        self._bus = bus
        self._station = station
        self._unit = station.unit

    @property
    def ports(self) -> tuple[str, ...]:
        return self._bus.ports

    @property
    def axes(self) -> tuple[str, ...]:
        return (_AXIS,)

    def connect(self, port: str, send: Send, closed: Callable[[], None]) -> Connection:
        """The line that it shares; raises `PortRefused`."""
        return self._bus.connect(port, send, closed)

    # The world

    def set_power(self, on: bool) -> None:
        self._station.set_power(on)

    def set_input(self, number: int, level: bool) -> None:
        if number == STOP_INPUT:
            self._unit.hold(level)
        elif 1 <= number <= USER_INPUTS:
            self._unit.inputs.set_user(number, level)
        else:
            raise ValueError(f"no input {number}; there are 1-{USER_INPUTS} and the Stop input {STOP_INPUT}")

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        self._require(axis)
        self._unit.drive.set_limits(which)

    def set_stalled(self, axis: str, stalled: bool) -> None:
        """Without effect on anything that the unit knows: it is open loop and counts the steps it commands."""
        del stalled
        self._require(axis)

    def push(self, axis: str, counts: int) -> None:
        """Of a motor at rest; raises `ValueError` while it turns."""
        self._require(axis)
        self._unit.drive.push(counts)

    def output(self, number: int) -> bool:
        if not 1 <= number <= USER_OUTPUTS:
            raise ValueError(f"no output {number}; there are 1-{USER_OUTPUTS}")
        return self._unit.outputs.level(number)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        self._unit.outputs.listeners.append(listener)

    # The truth

    def position(self, axis: str) -> float:
        """The position counter, with the part of a step that is under way."""
        self._require(axis)
        return self._unit.drive.exact()[0]

    def place(self, axis: str) -> float:
        self._require(axis)
        return self._unit.drive.place

    def velocity(self, axis: str) -> float:
        self._require(axis)
        return self._unit.drive.exact()[1] * self._unit.time.rate()

    def moving(self, axis: str) -> bool:
        self._require(axis)
        return self._unit.drive.moving

    def at_rest(self) -> bool:
        return not (self._unit.busy or self._station.decoding)

    @property
    def motions(self) -> Sequence[Motion]:
        return self._station.record

    def _require(self, axis: str) -> None:
        if axis != _AXIS:
            raise ValueError(f"no axis {axis!r}; a unit has {_AXIS}")


def build_bus(clock: Clock, units: Sequence[Branch]) -> tuple[Smc30Controller, list[BusUnit]]:
    """Powered-up units on one line, by their addresses; two may have the same. What concerns the line is said alike by
    all. Wires take their time here, so that any two replies that overlap garble each other unless the options say
    otherwise. Raises `ValueError`."""
    line: dict[str, object] = {"collisions": "any"}
    places: list[Place] = []
    for number, branch in enumerate(units):
        own = read_options({name: value for name, value in branch.options.items() if name not in _OF_THE_LINE})
        if own.units:
            raise ValueError("units: a unit of a shared line has none of its own")
        for name, value in _line_options(branch.options).items():
            if number and line.get(name) != value:
                raise ValueError(f"{name}: the units of one line must agree, found {line.get(name)!r} and {value!r}")
            line[name] = value
        chosen = own.model_copy(update={"address": branch.address or 0})
        generator = random.Random(f"{branch.seed}.{number}")
        places.append(Place(chosen, branch.oscillator, branch.timing, generator, _AXIS, []))
    bus = Smc30Controller(clock, read_options(line), places)
    return bus, [BusUnit(bus, station) for station in bus.stations]


def _line_options(options: Mapping[str, object]) -> dict[str, object]:
    return {name: options[name] for name in _OF_THE_LINE if name in options}
