"""The simulated CANopen drive with the profile CiA 402, alone or several on one bus. Its EDS file is `drive.eds`."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from orchestrator.clock.base import Clock
from orchestrator.model.fleet import Controller
from sim.cia402.campaign import CAMPAIGN
from sim.cia402.commissioning import make_options
from sim.cia402.options import DriveOptions
from sim.cia402.unit import SimulatedDrive, build_bus, build_drive
from sim.core.controller import DeviceSpec, FirmwareTiming, VectorBench
from sim.core.oscillator import Oscillator
from sim.link.can_card import CanSegment


class Cia402Simulator:
    """The model as the group `tutti.simulators` refers to it."""

    campaign = CAMPAIGN

    @property
    def model(self) -> str:
        return "cia402"

    def build_controller(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> SimulatedDrive:
        """Build a powered-up drive on a bus of its own; `ValueError` for a wrong option."""
        return build_drive(clock, options, oscillator, timing, seed)

    def build_shared(self, clock: Clock, devices: Sequence[DeviceSpec]) -> tuple[CanSegment, Sequence[SimulatedDrive]]:
        """Build drives on one bus, each a node; `ValueError` for a wrong option."""
        return build_bus(clock, devices)

    @property
    def options_model(self) -> type[BaseModel]:
        return DriveOptions

    def make_options(self, config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
        """The options with which it fits a controller's part of a fleet file."""
        return make_options(config, expected)

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> VectorBench:
        """Raise `ValueError`: vectors are lines of text, and this drive exchanges frames."""
        raise ValueError("the model cia402 has no test vectors: it exchanges frames, not lines")


CIA402 = Cia402Simulator()
