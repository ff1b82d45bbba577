"""Galil controllers: their driver, and the check of their part of the fleet file. Never tried on hardware."""

from collections.abc import Iterator, Mapping
from typing import Any, Literal

from pydantic import BaseModel

from adapters.contract import (
    ControllerIdentity,
    Driver,
    DriverSetup,
    ExamplePlace,
    validate_options,
)
from adapters.galil.device import GalilDevice
from adapters.galil.models import DMC21X3, DMC40X0, MAX_AXES
from adapters.galil.options import GalilOptions
from adapters.yaskawa.common.checks import Terminals, find_model_problems
from adapters.yaskawa.shapes.model import ModelTraits
from adapters.yaskawa.smc4000.driver import SMC4000Driver, SMC4000Make
from adapters.yaskawa.triggers.probe import find_ability
from adapters.yaskawa.wire.record import AXIS_LETTERS, RECORD_LETTERS
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import Controller
from orchestrator.model.state import ProbeAbility

FAMILIES = {"dmc21x3": DMC21X3, "dmc40x0": DMC40X0}
NAMES = (AXIS_LETTERS[:MAX_AXES], RECORD_LETTERS)
# Inputs and outputs are those of the first connector, which every controller of the families has.
TERMINALS = Terminals(NAMES, "A, B, C, D (or X, Y, Z, W)", inputs=8, outputs=8)
UNTRIED = "never tried on hardware"


class GalilDriver(SMC4000Driver):
    """One Galil controller: that of an SMC-4000, with trapezoids only."""

    DEVICE = GalilDevice
    OPTIONS = GalilOptions
    ORDERS: tuple[Literal[2, 3], ...] = (2,)
    EXTENDS = False  # no manual of the families was compared

    def __init__(self, setup: DriverSetup) -> None:
        super().__init__(setup)
        self._family = FAMILIES[GalilOptions.model_validate(setup.options.model_dump()).family]

    async def connect(self) -> ControllerIdentity:
        identity = await super().connect()
        device = self._device
        if isinstance(device, GalilDevice) and device.family is not self._family:
            family_name = device.family.name if device.family else "unknown"
            raise ControllerFault(
                "config-mismatch",
                f"the controller is a {family_name}; the fleet file says {self._family.name}",
                "correct `family` in the controller's options, or the address",
            )
        self._log.warning(f"adapter galil: {UNTRIED}; keep the wired e-stop within reach")
        return identity

    @property
    def traits(self) -> ModelTraits:
        return self._family.traits

    @property
    def probe_ability(self) -> ProbeAbility:
        return find_ability({}, 0)  # its latch has no target in any manual that was compared

    @property
    def line_ability(self) -> ProbeAbility | None:
        return None

    @property
    def limit_ability(self) -> ProbeAbility | None:
        return None


_EXAMPLE = """\
adapter: galil # DMC-21x3 and DMC-40x0; never tried on hardware
options: {{family: dmc40x0}} # or: dmc21x3
link: {{kind: tcp, host: 192.168.1.{host}, port: 23}}
axes:
  x:
    motors: [A] # A, B, C or D
    unit: mm # m, cm, mm, um, nm, in, deg, arcmin, arcsec, rad, mrad, rev, counts
    scale: 1000 # counts per mm, exact; a fraction in quotes: "10000/3"
    sign: 1 # -1: the controller counts in the opposite direction
    soft_limits: {{min: -10, max: 400}} # after homing, where position 0 is
    limits: {{velocity: 200 mm/s, acceleration: 1000 mm/s²}} # without jerk: trapezoids only
    homing: {{method: default, speed: 20 mm/s, timeout_s: 60}} # home switch, then index; or: edge, index
inputs:
  door: {{number: 1, active: low}} # low: active while the input is at 0 V
outputs:
  lamp: {{number: 1, safe: false}} # safe: what an e-stop sets
"""


class GalilMake(SMC4000Make):
    """The make for the entry point: it is stopped as an SMC-4000 is."""

    name = "galil"
    options_model: type[BaseModel] = GalilOptions
    gears_motors = False  # no manual of the families was compared

    def fleet_example(self, place: ExamplePlace) -> str:
        return _EXAMPLE.format(host=place.own_port + 20)

    @property
    def serial_defaults(self) -> Mapping[str, Any]:
        return {}

    def _find_problems(self, config: Controller) -> Iterator[str]:
        if config.link.kind != "tcp":
            yield f"link.kind: {config.link.kind}; this adapter speaks over tcp only"
        for name, axis in config.axes.items():
            if axis.limits.jerk is not None:
                yield f"axes.{name}.limits.jerk: this adapter moves in trapezoids; remove it"
        yield from find_model_problems(config, TERMINALS, validate_options(GalilOptions, config))

    def create_driver(self, setup: DriverSetup) -> Driver:
        return GalilDriver(setup)


MAKE = GalilMake()
