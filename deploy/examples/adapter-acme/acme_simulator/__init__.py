"""The simulator of acme."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from acme_simulator.controller import AcmeController
from tutti.adapter.simulator import (
    Clock,
    Controller,
    FirmwareTiming,
    LineDevice,
    Oscillator,
    search_distance,
)


class AcmeOptions(BaseModel):
    """The machine around the controller."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    switch_counts: dict[str, int] = Field(
        default={"X": -500, "Y": -500}, description="Where the reference switches are, from the position at power-up."
    )
    search_speed: float = Field(default=5000.0, gt=0, description="Speed of a search, counts/s.")


class AcmeBench:
    """The controller, ideal in time, for vectors."""

    port_name = "serial"

    def __init__(self, controller: AcmeController) -> None:
        self.controller = controller

    def apply_given(self, state: Mapping[str, object]) -> None:
        """Set up what a vector states. `ValueError` for what is unknown."""
        for name, value in state.items():
            if name != "position" or not isinstance(value, dict):
                raise ValueError(f"unknown state {name!r}; known: position")
            for axis, counts in value.items():
                self.controller.axes[axis].set_position(counts)

    def is_refusal(self, reply: bytes) -> bool:
        """Return whether the reply refuses a command."""
        return reply.startswith(b"ERR")


class AcmeSimulator:
    """The model for the entry point."""

    api_version = 1
    model = "acme"
    options_model: type[BaseModel] = AcmeOptions
    vector_files: Sequence[Path] = (Path(__file__).with_name("acme.vectors.jsonl"),)

    def build_controller(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> AcmeController:
        """Build a controller under power. `ValueError` for a wrong option."""
        read = AcmeOptions.model_validate(dict(options))
        return AcmeController(LineDevice(clock, oscillator, timing, seed), read.switch_counts, read.search_speed)

    def make_options(self, config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the options that fit a controller's part of a fleet file."""
        axes = config.axes.values()
        near = {axis.motors[0]: axis.homing_sign * search_distance(axis) for axis in axes}
        speeds = [(axis.homing.speed or axis.limits.velocity / 10) * float(axis.scale) for axis in axes]
        return {"switch_counts": near, "search_speed": min(speeds)}

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> AcmeBench:
        """Build the controller for vectors."""
        return AcmeBench(self.build_controller(clock, options))


ACME = AcmeSimulator()
