"""The simulated pp-electronic SMC step-motor controller (also sold as Huber SMC 9000 and 9300)."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from orchestrator.clock.base import Clock
from orchestrator.model.fleet import Controller
from sim.core.campaign import CampaignTraits
from sim.core.controller import FirmwareTiming, Simulator
from sim.core.oscillator import Oscillator
from sim.ppsmc.bench import PpsmcBench
from sim.ppsmc.commissioning import make_options
from sim.ppsmc.controller import PpsmcController, build_controller
from sim.ppsmc.options import PpsmcOptions, read_options


class _PpsmcSimulator:
    """The model, as the group `tutti.simulators` refers to it."""

    campaign = CampaignTraits(start_class="host", verifies_reference=True)

    @property
    def model(self) -> str:
        return "ppsmc"

    def build_controller(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> PpsmcController:
        """Build a powered-up controller; `ValueError` for a wrong option."""
        return build_controller(clock, read_options(options), oscillator, timing, seed)

    @property
    def options_model(self) -> type[BaseModel]:
        return PpsmcOptions

    def make_options(self, config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
        """The options with which it fits a controller's part of a fleet file."""
        return make_options(config, expected)

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> PpsmcBench:
        """Build a controller that is ideal in time."""
        return PpsmcBench(clock, options)


PPSMC: Simulator = _PpsmcSimulator()
