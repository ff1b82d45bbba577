"""The make for the entry point."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from adapters.cia402 import eds, fleetaxes
from adapters.cia402.canopen import states
from adapters.cia402.canopen.bus import RPDO, SDO_REQUEST
from adapters.cia402.canopen.objects import CONTROLWORD, OUTPUTS
from adapters.cia402.canopen.sdo import download_request
from adapters.cia402.decoder import Cia402Decoder
from adapters.cia402.driver import Cia402Driver
from adapters.cia402.options import Cia402Options
from adapters.cia402.power import quick_stop_by_sdo
from adapters.contract import DriverSetup, ExamplePlace, require_no_problems, validate_options
from adapters.toolkit.frames import FrameDecoder
from orchestrator.link.can import CanFrame, encode_frames
from orchestrator.model.fleet import Controller
from orchestrator.model.plugins import API_VERSION

_EXAMPLE = """\
adapter: cia402
link: {{kind: can, interface: slcan, channel: /dev/ttyACM{port}, address: {address}}} # or: socketcan, can0
# options: {{eds: drive.eds}} # the drive's EDS file: compared with the drive, and with what the adapter needs
axes:
  r:
    motors: ["1"] # the only one; every drive is a controller of its own
    unit: mm
    scale: 1000 # position units (6064h) per mm
    soft_limits: {{min: -200, max: 200}}
    limits: {{velocity: 80 mm/s, acceleration: 400 mm/s²}} # with `jerk`: positions are streamed
    homing: {{method: "37"}} # of 6098h; 37: the present position becomes the reference
"""


class Cia402Make:
    """A CANopen drive of CiA 402: one node of a CAN bus, which it may share with others."""

    api_version = API_VERSION

    @property
    def name(self) -> str:
        return "cia402"

    @property
    def options_model(self) -> type[BaseModel]:
        return Cia402Options

    def check_config(self, config: Controller) -> None:
        options = validate_options(Cia402Options, config)
        problems = list(fleetaxes.find_problems(config, options))
        if options.eds is not None and not problems:
            problems += eds.find_problems(options.eds, config, options)
        require_no_problems(problems)

    def fleet_example(self, place: ExamplePlace) -> str:
        return _EXAMPLE.format(port=place.port, address=place.number + 1)

    @property
    def serial_defaults(self) -> Mapping[str, Any]:
        return {}

    def create_driver(self, setup: DriverSetup) -> Cia402Driver:
        options = setup.options
        assert isinstance(options, Cia402Options)
        return Cia402Driver(setup, options)

    def make_decoder(self, options: Mapping[str, Any]) -> FrameDecoder:
        return Cia402Decoder(Cia402Options.model_validate(options))

    def stop_bytes(self, config: Controller) -> bytes:
        """Return a quick stop, by SDO because the mapping of its PDOs is unknown; before it, a frame overwrites the
        command that waits for a SYNC, because that SYNC may still be sent; after it, outputs that a stream may have
        switched are made passive."""
        node = fleetaxes.node_number(config)
        stop_data = CONTROLWORD.encode(states.QUICK_STOP)
        if config.outputs:
            stop_data += OUTPUTS.encode(fleetaxes.passive_outputs(config))
        frames = [CanFrame(RPDO[0] + node, stop_data), quick_stop_by_sdo(node)]
        if fleetaxes.may_switch(config):
            passive = download_request(OUTPUTS, fleetaxes.passive_outputs(config))
            frames.append(CanFrame(SDO_REQUEST + node, passive))
        return encode_frames(*frames)
