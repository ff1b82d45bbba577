"""The make for the entry point."""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict

from adapters.contract import Driver, DriverSetup, ExamplePlace, require_no_problems
from adapters.light.driver import LightDriver
from orchestrator.model.fleet import Controller
from orchestrator.model.plugins import API_VERSION

MOTORS = ("1", "2", "3", "4")
_EXAMPLE = """\
adapter: light # exists in no hardware: for benchmarks and tests
link: {{kind: process, device: light-{number}}} # in the process of its adapter
axes:
  x:
    motors: ["1"] # 1 to 4
    unit: mm
    scale: 1000 # counts per mm
    soft_limits: {{min: 0, max: 400}}
    limits: {{velocity: 200 mm/s, acceleration: 1000 mm/s²}} # without jerk: trapezoids only
    homing: {{method: here, speed: 20 mm/s, timeout_s: 60}}
"""


class LightOptions(BaseModel):
    """It has no options."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class LightMake:
    """Controllers that are simulated in the process of their adapter. `is_listed`: no list of makes has it."""

    api_version = API_VERSION
    is_listed = False

    @property
    def name(self) -> str:
        return "light"

    @property
    def options_model(self) -> type[BaseModel]:
        return LightOptions

    def check_config(self, config: Controller) -> None:
        require_no_problems(_find_problems(config))

    def fleet_example(self, place: ExamplePlace) -> str:
        return _EXAMPLE.format(number=place.number + 1)

    @property
    def serial_defaults(self) -> Mapping[str, Any]:
        return {}

    def create_driver(self, setup: DriverSetup) -> Driver:
        return LightDriver(setup)

    def stop_bytes(self, config: Controller) -> bytes:
        """Return a stop by the ramps."""
        del config
        return b"S\x00"


def _find_problems(config: Controller) -> Iterator[str]:
    if config.link.kind != "process":
        yield f"link.kind: {config.link.kind}; a light controller is in the process of its adapter: `kind: process`"
    for name, axis in config.axes.items():
        if axis.limits.jerk is not None:
            yield f"axes.{name}.limits.jerk: this adapter moves in trapezoids; remove it"
        if len(axis.motors) != 1 or axis.motors[0] not in MOTORS:
            yield f"axes.{name}.motors: {', '.join(axis.motors)}; allowed are {', '.join(MOTORS)}"
    if config.inputs or config.outputs:
        yield "inputs: a light controller has no inputs and outputs; remove them"


MAKE = LightMake()
