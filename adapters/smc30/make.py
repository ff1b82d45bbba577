"""The make: what the entry point names."""

from pydantic import BaseModel

from adapters.contract import Setup
from adapters.smc30 import unitaxis
from adapters.smc30.driver import SmcDriver
from adapters.smc30.frames import CR, checksum, line
from adapters.smc30.options import Options
from orchestrator.model.fleet import Controller


class Smc30:
    """JVL SMC30B and SMC30C over a serial port, alone or up to seven on one, or a unit behind a TCP bridge."""

    @property
    def name(self) -> str:
        return "smc30"

    @property
    def options(self) -> type[BaseModel]:
        return Options

    def check(self, config: Controller) -> None:
        unitaxis.check(config)

    def driver(self, setup: Setup) -> SmcDriver:
        options = setup.options
        assert isinstance(options, Options)
        return SmcDriver(setup, options)

    def stop_bytes(self, config: Controller) -> bytes:
        """Spoil what is half-typed, and stop all units of the line.

        By ramp; but the one whose checksum would be a CR is killed, because it is not said whether that is understood.
        """
        with_checksum = Options.model_validate(config.options).checksum
        own = unitaxis.address(config)
        units = [None] if own is None else list(unitaxis.UNITS)
        return b"?\r" + b"".join(_stop(unit, with_checksum) for unit in units)


def _stop(unit: int | None, with_checksum: bool) -> bytes:
    unclear = with_checksum and checksum(line("Z", unit, with_checksum=False)[:-1]) == CR
    return line("K" if unclear else "Z", unit, with_checksum)
