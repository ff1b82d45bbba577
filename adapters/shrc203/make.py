"""The make: what the entry point names."""

from pydantic import BaseModel

from adapters.contract import Setup
from adapters.shrc203 import fleetaxes
from adapters.shrc203.driver import ShrcDriver
from adapters.shrc203.options import Options
from orchestrator.model.fleet import Controller


class Shrc203:
    """OptoSigma SHRC-203 in command format SHOT/FC, over a serial port or a TCP bridge to one.

    The direction of an origin return is the unit's own (memory switch ORG): `homing.direction` has no effect.
    """

    @property
    def name(self) -> str:
        return "shrc203"

    @property
    def options(self) -> type[BaseModel]:
        return Options

    def check(self, config: Controller) -> None:
        fleetaxes.check(config)

    def driver(self, setup: Setup) -> ShrcDriver:
        options = setup.options
        assert isinstance(options, Options)
        return ShrcDriver(setup, options)

    def stop_bytes(self, config: Controller) -> bytes:
        """End what is half-typed; stop all, then each axis, because the first is refused where a motor is off.

        A move may wait for an input, or behind another one: it is overwritten first, because what `L:` makes of that is
        not said (L2955).
        """
        motors = sorted(fleetaxes.motors(config).values())
        waiting = [f"MP:{motor}+P0" for motor in motors]
        return "".join(f"{line}\r\n" for line in ("", *waiting, "L:W", *(f"L:{motor}" for motor in motors))).encode()
