"""The make: what the entry point names."""

from pydantic import BaseModel

from adapters.cia402 import eds, fleetaxes, states
from adapters.cia402.bus import RPDO
from adapters.cia402.driver import CiaDriver
from adapters.cia402.objects import CONTROLWORD, OUTPUTS
from adapters.cia402.options import Options
from adapters.cia402.pdo import pdos
from adapters.cia402.power import quick_stop_by_sdo
from adapters.contract import Setup
from orchestrator.link.can import CanFrame, encode
from orchestrator.model.fleet import Controller


class Cia402:
    """A CANopen drive of CiA 402: one node of a CAN bus, which it may share with others."""

    @property
    def name(self) -> str:
        return "cia402"

    @property
    def options(self) -> type[BaseModel]:
        return Options

    def check(self, config: Controller) -> None:
        options = Options.model_validate(config.options)
        fleetaxes.check(config, options)
        if options.eds is not None:
            eds.read(options.eds, pdos(options, outputs=bool(config.outputs)))

    def driver(self, setup: Setup) -> CiaDriver:
        options = setup.options
        assert isinstance(options, Options)
        return CiaDriver(setup, options)

    def stop_bytes(self, config: Controller) -> bytes:
        """A quick stop, by SDO because nobody knows what its PDOs carry; first of all what waits for a SYNC is
        overwritten by one, because that SYNC may still be fired."""
        node = fleetaxes.node(config)
        waiting = CONTROLWORD.encode(states.QUICK_STOP)
        if config.outputs:
            waiting += OUTPUTS.encode(fleetaxes.passive_outputs(config))
        return encode(CanFrame(RPDO[0] + node, waiting), quick_stop_by_sdo(node))
