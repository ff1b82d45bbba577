"""Simulated controllers with simple text lines: GRBL 1.1, grblHAL, and a stage in the manner of SCPI."""

from collections.abc import Callable, Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from orchestrator.clock.base import Clock
from orchestrator.model.fleet import Axis, Controller
from sim.ascii.grbl import GrblController, GrblMachine
from sim.ascii.grbl_family import GRBL, GRBLHAL, GrblFamily
from sim.ascii.scpi import ScpiStage, StageMachine
from sim.core.commissioning import search_distance, span_counts
from sim.core.controller import FirmwareTiming
from sim.core.lines import LineController, LineDevice
from sim.core.oscillator import Oscillator

_GRBL_MOTORS = "XYZ"
_FAMILIES: Mapping[str, GrblFamily] = {"grbl": GRBL, "grblhal": GRBLHAL}
_PULL_OFF_MM = 1.0  # $27, and where the fleet file says nothing else minus the position at the reference


class AsciiOptions(BaseModel):
    """What is simulated, and the machine around it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    model: Literal["grbl", "grblhal", "scpi-stage"] = "grbl"
    settings: dict[str, float] = Field(default={}, description="GRBL: values of its settings, by number, e.g. '120'.")
    switch_counts: dict[str, int] = Field(
        default={}, description="Where the reference switches are, from the position at power-up, by motor."
    )
    counts_per_unit: dict[str, float] = Field(default={}, description="SCPI stage: counts per unit, by motor.")
    search_speed: float = Field(default=10.0, gt=0, description="Speed of a search, units/s.")
    startup_ms: int = Field(default=0, ge=0, le=60_000, description="After power-up nothing is received for this time.")


class AsciiBench:
    """A controller, ideal in time, for vectors."""

    port_name = "serial"

    def __init__(self, controller: LineController, refusals: tuple[bytes, ...]) -> None:
        self.controller = controller
        self._refusals = refusals

    def apply_given(self, state: Mapping[str, object]) -> None:
        """Set positions of axes. `ValueError` for what is unknown."""
        for name, value in state.items():
            if name not in self.controller.axes or not isinstance(value, int | float):
                raise ValueError(f"unknown state {name!r}; known: {', '.join(self.controller.axes)}, in counts")
            self.controller.axes[name].set_position(value)

    def is_refusal(self, reply: bytes) -> bool:
        """Return whether the reply refuses a command."""
        return reply.startswith(self._refusals)


class AsciiSimulator:
    """The model as the group `tutti.simulators` refers to it."""

    @property
    def model(self) -> str:
        return "ascii"

    @property
    def options_model(self) -> type[BaseModel]:
        return AsciiOptions

    def build_controller(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> LineController:
        """Build a powered-up controller; `ValueError` for a wrong option."""
        ascii_options = AsciiOptions.model_validate(dict(options))
        return _BUILDERS[ascii_options.model](ascii_options, LineDevice(clock, oscillator, timing, seed))

    def make_options(self, config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
        """The options with which it fits a controller's part of a fleet file. expected: the adapter's options; its
        `description` says which controller it is. `ValueError` for one that is not simulated."""
        model = str(expected.get("description", "grbl"))
        if "model" in config.simulate.options:
            model = str(config.simulate.options["model"])
        if model not in _BUILDERS:
            raise ValueError(
                f"there is no simulator for the description {model}; state `simulate.options.model`: "
                f"{' or '.join(_BUILDERS)}"
            )
        axes = {axis.motors[0]: axis for axis in config.axes.values()}
        switches = {motor: axis.homing_sign * search_distance(axis) for motor, axis in axes.items()}
        speeds = [axis.homing.speed or axis.limits.velocity / 10 for axis in axes.values()]
        options: dict[str, Any] = {"model": model, "switch_counts": switches, "search_speed": min(speeds)}
        if model not in _FAMILIES:
            return {**options, "counts_per_unit": {motor: float(axis.scale) for motor, axis in axes.items()}}
        return {**options, "settings": _make_settings(axes, dict(expected.get("reference", {})))}

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> AsciiBench:
        """Build a controller whose firmware takes no time."""
        return AsciiBench(self.build_controller(clock, options), (b"error:", b"-"))


def _make_settings(axes: Mapping[str, Axis], references: Mapping[str, float]) -> dict[str, float]:
    """The settings of GRBL for a machine. axes, references (machine positions after homing, mm): by motor."""
    settings = {"10": 3.0, "22": 1.0, "23": 0.0, "27": _PULL_OFF_MM}
    for motor, axis in axes.items():
        number = _GRBL_MOTORS.index(motor)
        settings |= {
            f"10{number}": float(axis.scale),
            f"11{number}": axis.limits.velocity * 60,
            f"12{number}": axis.limits.acceleration,
            f"13{number}": span_counts(axis) / float(axis.scale),
        }
        if axis.homing_sign < 0:
            settings["23"] += 1 << number
            if motor in references:
                settings[f"13{number}"] = settings["27"] - references[motor]
        else:
            settings["27"] = -references.get(motor, -_PULL_OFF_MM)
    return settings


def _build_grbl(options: AsciiOptions, device: LineDevice) -> LineController:
    family = _FAMILIES[options.model]
    machine = GrblMachine(family, options.switch_counts, options.search_speed, options.startup_ms)
    return GrblController(device, {int(number): value for number, value in options.settings.items()}, machine)


def _build_stage(options: AsciiOptions, device: LineDevice) -> LineController:
    machine = StageMachine(options.counts_per_unit, options.switch_counts, options.search_speed, options.startup_ms)
    return ScpiStage(device, machine)


_BUILDERS: dict[str, Callable[[AsciiOptions, LineDevice], LineController]] = {
    "grbl": _build_grbl,
    "grblhal": _build_grbl,
    "scpi-stage": _build_stage,
}

ASCII = AsciiSimulator()
