"""The model, as the group `tutti.simulators` refers to it."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.model.explain import list_problems
from orchestrator.model.fleet import Controller
from sim.core.campaign import CampaignTraits
from sim.core.controller import FirmwareTiming, VectorBench
from sim.core.oscillator import Oscillator
from sim.light.controller import LightController

MAX_AXES = 4


class LightOptions(BaseModel):
    """Options of a light controller: the number of its axes, whose motors are 1 to 4."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    axes: int = Field(default=MAX_AXES, ge=1, le=MAX_AXES)


class LightSimulator:
    """The model. It is for benchmarks and tests: the makes that are listed do not have it."""

    campaign = CampaignTraits(start_class="clock", loads=lambda request: request.startswith(b"L"))

    @property
    def model(self) -> str:
        return "light"

    def build_controller(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> LightController:
        """Build a powered-up controller; `ValueError` for a wrong option. It answers at once, whatever `timing` is."""
        del timing, seed
        try:
            read_options = LightOptions.model_validate(dict(options))
        except ValidationError as error:
            texts = [f"{'.'.join(map(str, p.place))}: {p.text}" for p in list_problems(error, LightOptions)]
            raise ValueError("; ".join(texts)) from None
        names = [str(number) for number in range(1, read_options.axes + 1)]
        return LightController(clock, names, oscillator or Oscillator())

    def build_inside(self, clock: Clock, config: Controller) -> LightController:
        """Build the controller of a fleet file, in the process of its adapter."""
        simulate = config.simulate
        oscillator = Oscillator(round(simulate.offset_s * NS_PER_S), simulate.drift_ppm)
        return self.build_controller(clock, self.make_options(config, {}), oscillator=oscillator)

    @property
    def options_model(self) -> type[BaseModel]:
        return LightOptions

    def make_options(self, config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
        """The options with which it fits a controller's part of a fleet file."""
        del expected
        return {"axes": max(int(axis.motors[0]) for axis in config.axes.values())}

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> VectorBench:
        """Raise `ValueError`: its frames are in no manual, so that there are no vectors."""
        raise ValueError("the light controller has no test vectors")


LIGHT = LightSimulator()
