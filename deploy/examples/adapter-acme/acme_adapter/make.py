"""The make for the entry point."""

from collections.abc import Mapping
from typing import Any

from acme_adapter.dialect import AcmeDialect
from tutti.adapter import (
    Controller,
    DriverSetup,
    ExamplePlace,
    require_no_problems,
    validate_options,
)
from tutti.adapter.lines import CountScale, LineDriver, LineOptions

MOTORS = ("X", "Y")
_EXAMPLE = """\
adapter: acme
link: {{kind: serial, device: /dev/ttyUSB{port}}}
axes:
  x:
    motors: [X] # X or Y
    unit: mm
    scale: 1000 # counts per mm
    soft_limits: {{min: 0, max: 200}}
    limits: {{velocity: 50 mm/s, acceleration: 250 mm/s²}}
    homing: {{timeout_s: 60}}
  y:
    motors: [Y]
    unit: mm
    scale: 1000
    soft_limits: {{min: 0, max: 200}}
    limits: {{velocity: 50 mm/s, acceleration: 250 mm/s²}}
    homing: {{timeout_s: 60}}
"""


class AcmeMake:
    """The make acme."""

    api_version = 2  # of the contract; `tutti adapter ls` shows that of the installed Tutti
    name = "acme"
    options_model: type[LineOptions] = LineOptions
    serial_defaults: Mapping[str, Any] = {"baud": 115200}

    def check_config(self, config: Controller) -> None:
        """Check a controller's part of the fleet file. Raises `ConfigError`."""
        validate_options(LineOptions, config)
        require_no_problems(
            f"axes.{name}.motors: {axis.motors[0]!r} is none of {', '.join(MOTORS)}"
            for name, axis in config.axes.items()
            if axis.motors[0] not in MOTORS
        )

    def fleet_example(self, place: ExamplePlace) -> str:
        """Return a commented example."""
        return _EXAMPLE.format(port=place.own_port)

    def create_driver(self, setup: DriverSetup) -> LineDriver:
        """Create the driver of one controller."""
        assert isinstance(setup.options, LineOptions)
        scales = dict.fromkeys(setup.config.axes, CountScale(1.0))
        return LineDriver(setup, setup.options, AcmeDialect(), scales)

    def stop_bytes(self, config: Controller) -> bytes:
        """Return the bytes of a guardian."""
        dialect = AcmeDialect()
        return dialect.spoiler + dialect.stop_bytes


MAKE = AcmeMake()
