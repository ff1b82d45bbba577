"""The make for the entry point."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from adapters.contract import DriverSetup, ExamplePlace, require_no_problems, validate_options
from adapters.smc30 import unitaxis
from adapters.smc30.decoder import Smc30Decoder
from adapters.smc30.driver import Smc30Driver
from adapters.smc30.frames import CR, frame_line, line_checksum
from adapters.smc30.options import Smc30DriverOptions
from adapters.toolkit.frames import FrameDecoder
from orchestrator.model.fleet import Controller
from orchestrator.model.plugins import API_VERSION

_EXAMPLE = """\
adapter: smc30
link: {{kind: serial, device: /dev/ttyUSB{port}, address: {address}}} # DIP switches A0 to A2; up to 7 on one port
options: {{checksum: true}} # DIP switch CHS
axes:
  z:
    motors: ["1"] # the only one
    unit: mm
    scale: 400 # steps per mm
    soft_limits: {{min: 0, max: 100}} # a search ends on the end-of-travel switch, which then is position 0
    limits: {{velocity: 10 mm/s, acceleration: 50 mm/s²}}
    start_rate: {{min: 0.05 mm/s, max: 1 mm/s}} # 16 to 2000 steps/s
    homing: {{method: default, direction: negative, speed: 2 mm/s, timeout_s: 60}}
"""


class Smc30Make:
    """JVL SMC30B and SMC30C over a serial port, alone or up to seven on one, or a controller behind a TCP bridge."""

    api_version = API_VERSION
    searches_by_direction = True

    @property
    def name(self) -> str:
        return "smc30"

    @property
    def options_model(self) -> type[BaseModel]:
        return Smc30DriverOptions

    def check_config(self, config: Controller) -> None:
        validate_options(Smc30DriverOptions, config)
        require_no_problems(unitaxis.find_problems(config))

    def fleet_example(self, place: ExamplePlace) -> str:
        return _EXAMPLE.format(port=place.port, address=place.number + 1)

    @property
    def serial_defaults(self) -> Mapping[str, Any]:
        return {"baud": 9600, "data_bits": 7, "parity": "odd"}

    def create_driver(self, setup: DriverSetup) -> Smc30Driver:
        options = setup.options
        assert isinstance(options, Smc30DriverOptions)
        return Smc30Driver(setup, options)

    def make_decoder(self, options: Mapping[str, Any]) -> FrameDecoder:
        return Smc30Decoder(with_checksum=Smc30DriverOptions.model_validate(options).checksum)

    def stop_bytes(self, config: Controller) -> bytes:
        """Return bytes that spoil a half-typed command, and stop all controllers of the line.

        By ramp; but a controller whose checksum would be a CR is killed, because the manual does not state whether that
        command is understood.
        """
        with_checksum = Smc30DriverOptions.model_validate(config.options).checksum
        own = unitaxis.line_address(config)
        units = [None] if own is None else list(unitaxis.LINE_ADDRESSES)
        return b"?\r" + b"".join(_stop_frames(unit, with_checksum=with_checksum) for unit in units)


def _stop_frames(unit: int | None, *, with_checksum: bool) -> bytes:
    unclear = with_checksum and line_checksum(frame_line("Z", unit, with_checksum=False)[:-1]) == CR
    return frame_line("K" if unclear else "Z", unit, with_checksum=with_checksum)
