"""The simulated OptoSigma SHRC-203 three-axis stage controller, command format SHOT/FC."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from orchestrator.clock.base import Clock
from orchestrator.model.fleet import Controller
from sim.core.campaign import BodyCarrier, CampaignTraits, TouchInput
from sim.core.controller import FirmwareTiming, Simulator
from sim.core.oscillator import Oscillator
from sim.shrc203.bench import Shrc203Bench
from sim.shrc203.commissioning import make_options
from sim.shrc203.controller import Shrc203Controller, build_controller
from sim.shrc203.options import Shrc203Options, read_options


class _Shrc203Simulator:
    """The model, as the group `tutti.simulators` refers to it."""

    campaign = CampaignTraits(
        refuse_reply=lambda data: b"NG\r\n" if data.endswith(b"\r\n") else data,
        start_class="host",
        touch=TouchInput(1, "high", "host"),
        body=BodyCarrier(),
    )

    @property
    def model(self) -> str:
        return "shrc203"

    def build_controller(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> Shrc203Controller:
        """Build a powered-up controller; `ValueError` for a wrong option."""
        return build_controller(clock, read_options(options), oscillator, timing, seed)

    @property
    def options_model(self) -> type[BaseModel]:
        return Shrc203Options

    def make_options(self, config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
        """The options with which it fits a controller's part of a fleet file."""
        return make_options(config, expected)

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> Shrc203Bench:
        """Build a controller that is ideal in time."""
        return Shrc203Bench(build_controller(clock, read_options(options), None, None, None))


SHRC203: Simulator = _Shrc203Simulator()
