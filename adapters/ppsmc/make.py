"""The make: what the entry point names."""

from pydantic import BaseModel

from adapters.contract import Setup
from adapters.ppsmc import fleetaxes
from adapters.ppsmc.driver import PpSmcDriver
from adapters.ppsmc.options import Options
from adapters.ppsmc.session import EOL, SPOILER
from orchestrator.model.fleet import Controller


class PpSmc:
    """pp-electronic SMC, over TCP or a serial port. Counts are motor steps.

    The unit can not switch motors off: a disabled axis is one that the adapter does not move.
    """

    @property
    def name(self) -> str:
        return "ppsmc"

    @property
    def options(self) -> type[BaseModel]:
        return Options

    def check(self, config: Controller) -> None:
        fleetaxes.check(config, Options.model_validate(config.options))

    def driver(self, setup: Setup) -> PpSmcDriver:
        options = setup.options
        assert isinstance(options, Options)
        return PpSmcDriver(setup, options)

    def stop_bytes(self, config: Controller) -> bytes:
        """`q` for all axes, never blocked by what others have asked (L2542). Twice: noise may spoil the first."""
        half_typed = SPOILER if config.link.kind == "serial" else ""
        return "".join(f"{line}{EOL}" for line in (half_typed, "q", "q")).encode()
