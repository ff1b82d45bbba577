"""SMC30 devices that share one serial line as separate controllers of a fleet (L875-L884)."""

import random
from collections.abc import Callable, Mapping, Sequence

from orchestrator.clock.base import Clock
from sim.core.controller import CommandedMotion, DeviceSpec, LimitSwitch, PortConnection, SendBytes, refuse_analog
from sim.smc30.controller import STOP_INPUT, BusStation, DeviceSetup, Smc30Controller
from sim.smc30.inputs import ANALOGUE_INPUTS, USER_INPUTS
from sim.smc30.options import IndexerOptions, Smc30Options, read_options
from sim.smc30.outputs import USER_OUTPUTS

_AXIS = "1"
_OF_THE_LINE = tuple(sorted(Smc30Options.model_fields.keys() - IndexerOptions.model_fields.keys() - {"units"}))


class BusDevice:
    """One device of a bus; implements `SimulatedController`. Axis `1`, inputs 1-3, and 4 the Stop input."""

    def __init__(self, bus: Smc30Controller, station: BusStation) -> None:
        self._bus = bus
        self._station = station
        self._unit = station.unit

    @property
    def port_names(self) -> tuple[str, ...]:
        return self._bus.port_names

    @property
    def axis_names(self) -> tuple[str, ...]:
        return (_AXIS,)

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> PortConnection:
        """Connect to the shared line; raises `PortRefused`."""
        return self._bus.connect(port, send, closed)

    # Environment

    def set_power(self, *, on: bool) -> None:
        self._station.set_power(on=on)

    def set_input(self, number: int, *, level: bool) -> None:
        if number == STOP_INPUT:
            self._unit.set_stop_input(held=level)
        elif 1 <= number <= USER_INPUTS:
            self._unit.inputs.set_user(number, level=level)
        else:
            raise ValueError(f"no input {number}; there are 1-{USER_INPUTS} and the Stop input {STOP_INPUT}")

    def set_analog(self, number: int, volts: float) -> None:
        if not 1 <= number <= ANALOGUE_INPUTS:
            refuse_analog(number, f"1 to {ANALOGUE_INPUTS}")
        self._unit.inputs.set_volts(number, volts)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        self._require_axis(axis)
        self._unit.drive.set_limits(which)

    def set_stalled(self, axis: str, *, stalled: bool) -> None:
        """Ignored by the device: it is open loop and counts the steps it commands."""
        del stalled
        self._require_axis(axis)

    def push_axis(self, axis: str, counts: int) -> None:
        """Push a motor at rest; raises `ValueError` while it turns."""
        self._require_axis(axis)
        self._unit.drive.push_axis(counts)

    def output_level(self, number: int) -> bool:
        if not 1 <= number <= USER_OUTPUTS:
            raise ValueError(f"no output {number}; there are 1-{USER_OUTPUTS}")
        return self._unit.outputs.output_level(number)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        self._unit.outputs.listeners.append(listener)

    # Ground truth

    def position(self, axis: str) -> float:
        """Position counter, with the fraction of the step in progress."""
        self._require_axis(axis)
        return self._unit.drive.exact_state()[0]

    def physical_position(self, axis: str) -> float:
        self._require_axis(axis)
        return self._unit.drive.physical_steps

    def velocity(self, axis: str) -> float:
        self._require_axis(axis)
        return self._unit.drive.exact_state()[1] * self._unit.time.clock_rate()

    def is_moving(self, axis: str) -> bool:
        self._require_axis(axis)
        return self._unit.drive.is_moving

    def at_rest(self) -> bool:
        return not (self._unit.is_busy or self._station.is_decoding)

    @property
    def commanded_motions(self) -> Sequence[CommandedMotion]:
        return self._station.record

    def _require_axis(self, axis: str) -> None:
        if axis != _AXIS:
            raise ValueError(f"no axis {axis!r}; a device has {_AXIS}")


def build_bus(clock: Clock, devices: Sequence[DeviceSpec]) -> tuple[Smc30Controller, list[BusDevice]]:
    """Build powered-up devices on one line, by their addresses; two may have the same. All must give the same line
    options. Cables take their time here, so that any two overlapping replies garble each other unless the options
    exclude it. Raises `ValueError`."""
    line: dict[str, object] = {"collisions": "any"}
    places: list[DeviceSetup] = []
    for number, branch in enumerate(devices):
        own = read_options({name: value for name, value in branch.options.items() if name not in _OF_THE_LINE})
        if own.units:
            raise ValueError("units: a device on a shared line cannot have units of its own")
        for name, value in _line_options(branch.options).items():
            if number and line.get(name) != value:
                raise ValueError(f"{name}: the devices of one line must agree, found {line.get(name)!r} and {value!r}")
            line[name] = value
        chosen_options = own.model_copy(update={"address": branch.address or 0})
        generator = random.Random(f"{branch.seed}.{number}")
        places.append(
            DeviceSetup(
                options=chosen_options,
                oscillator=branch.oscillator,
                timing=branch.timing,
                generator=generator,
                axis=_AXIS,
                record=[],
            )
        )
    bus = Smc30Controller(clock, read_options(line), places)
    return bus, [BusDevice(bus, station) for station in bus.bus_stations]


def _line_options(options: Mapping[str, object]) -> dict[str, object]:
    return {name: options[name] for name in _OF_THE_LINE if name in options}
