"""The make for the entry point."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from adapters.contract import DriverSetup, ExamplePlace, require_no_problems
from adapters.shrc203 import fleetaxes
from adapters.shrc203.driver import ShrcDriver
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.wire.decoder import Shrc203Decoder
from adapters.toolkit.frames import FrameDecoder
from orchestrator.model.fleet import Controller
from orchestrator.model.plugins import API_VERSION

_EXAMPLE = """\
adapter: shrc203
link: {{kind: serial, device: /dev/ttyUSB{own_port}, baud: 38400}} # as memory switch INTERFACE says
axes:
  u:
    motors: ["1"] # 1, 2 or 3
    unit: mm
    scale: 10000 # pulses per mm: one pulse is 100 nm, which is compared with the controller
    soft_limits: {{min: -1, max: 50}}
    limits: {{velocity: 10 mm/s, acceleration: 50 mm/s²}}
    start_rate: {{min: 0.001 mm/s, max: 0.5 mm/s}} # speeds at which the stepper starts without a ramp
    homing: {{speed: 2 mm/s, timeout_s: 60}} # its direction is set in the controller (memory switch ORG)
  focus:
    motors: ["2"]
    unit: um
    scale: 10 # pulses per µm
    soft_limits: {{min: -100, max: 5000}}
    limits: {{velocity: 5000 um/s, acceleration: 20000 um/s²}}
    start_rate: {{min: 0.1 um/s, max: 500 um/s}}
    homing: {{speed: 1000 um/s}}
"""


class Shrc203Make:
    """OptoSigma SHRC-203 in command format SHOT/FC, over a serial port or a TCP bridge to one.

    The direction of an origin return is set in the controller (memory switch ORG): `homing.direction` has no effect.
    """

    api_version = API_VERSION

    @property
    def name(self) -> str:
        return "shrc203"

    @property
    def options_model(self) -> type[BaseModel]:
        return ShrcOptions

    def check_config(self, config: Controller) -> None:
        require_no_problems(fleetaxes.find_problems(config))

    def fleet_example(self, place: ExamplePlace) -> str:
        return _EXAMPLE.format(own_port=place.own_port)

    @property
    def serial_defaults(self) -> Mapping[str, Any]:
        # The manual's volume on interfaces is another one; this is what published clients use.
        return {"baud": 38400}

    def create_driver(self, setup: DriverSetup) -> ShrcDriver:
        options = setup.options
        assert isinstance(options, ShrcOptions)
        return ShrcDriver(setup, options)

    def make_decoder(self, options: Mapping[str, Any]) -> FrameDecoder:
        del options
        return Shrc203Decoder()

    def stop_bytes(self, config: Controller) -> bytes:
        """Return bytes that end a half-typed command and stop all axes, then each axis, because the first is refused
        where a motor is off.

        A move may wait for an input, or for another move: it is overwritten first, because the manual does not state
        what `L:` does with it (L2955).
        """
        motors = sorted(fleetaxes.motor_numbers(config).values())
        queue_lines = [f"MP:{motor}+P0" for motor in motors]
        return "".join(
            f"{line}\r\n" for line in ("", *queue_lines, "L:W", *(f"L:{motor}" for motor in motors))
        ).encode()
