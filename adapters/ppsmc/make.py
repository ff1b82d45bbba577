"""The make for the entry point."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from adapters.contract import DriverSetup, ExamplePlace, require_no_problems, validate_options
from adapters.ppsmc import fleetaxes
from adapters.ppsmc.batches import EOL
from adapters.ppsmc.decoder import PpSmcDecoder
from adapters.ppsmc.driver import PpSmcDriver
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.session import SPOILER
from adapters.toolkit.frames import FrameDecoder
from orchestrator.model.fleet import Controller
from orchestrator.model.plugins import API_VERSION

_EXAMPLE = """\
adapter: ppsmc
link: {{kind: tcp, host: 192.168.1.{host}, port: 1234}}
axes:
  turn:
    motors: ["1"] # 1 to 16
    unit: deg
    kind: rotary
    scale: 1000 # steps per degree, which is compared with gnum / gden
    soft_limits: {{min: -200, max: 200}}
    limits: {{velocity: 40 deg/s, acceleration: 100 deg/s²}}
    start_rate: {{min: 0.1 deg/s, max: 2 deg/s}}
    homing: {{method: default, speed: 10 deg/s, timeout_s: 60}} # the ORG switch; or: ref, index, switch, limit, here
# options: {{io_port: true}} # the option with 8 inputs and 8 outputs is installed
"""


class PpSmcMake:
    """pp-electronic SMC, over TCP or a serial port. Counts are motor steps.

    The controller cannot switch motors off: the adapter does not move a disabled axis.
    """

    api_version = API_VERSION
    searches_by_direction = True

    @property
    def name(self) -> str:
        return "ppsmc"

    @property
    def options_model(self) -> type[BaseModel]:
        return PpSmcOptions

    def check_config(self, config: Controller) -> None:
        require_no_problems(fleetaxes.find_problems(config, validate_options(PpSmcOptions, config)))

    def fleet_example(self, place: ExamplePlace) -> str:
        return _EXAMPLE.format(host=place.own_port + 20)

    @property
    def serial_defaults(self) -> Mapping[str, Any]:
        return {}

    def create_driver(self, setup: DriverSetup) -> PpSmcDriver:
        options = setup.options
        assert isinstance(options, PpSmcOptions)
        return PpSmcDriver(setup, options)

    def make_decoder(self, options: Mapping[str, Any]) -> FrameDecoder:
        del options
        return PpSmcDecoder()

    def stop_bytes(self, config: Controller) -> bytes:
        """Return `q` for all axes, which no other client's commands can block (L2542). Twice: noise may spoil the
        first."""
        half_typed = SPOILER if config.link.kind == "serial" else ""
        return "".join(f"{line}{EOL}" for line in (half_typed, "q", "q")).encode()
