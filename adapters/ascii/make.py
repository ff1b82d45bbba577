"""The make for the entry point."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, Field

from adapters.ascii.decoder import DescribedDecoder
from adapters.ascii.description import Description, DescriptionError, load_description, packaged_names
from adapters.ascii.dialect import DescribedDialect
from adapters.contract import ConfigError, DriverSetup, ExamplePlace, require_no_problems, validate_options
from adapters.toolkit.frames import FrameDecoder
from adapters.toolkit.lines.driver import LineDriver
from adapters.toolkit.lines.lowering import CountScale
from adapters.toolkit.lines.options import LineOptions
from orchestrator.model.fleet import Controller
from orchestrator.model.plugins import API_VERSION

_EXAMPLE = """\
adapter: ascii
link: {{kind: serial, device: /dev/ttyUSB{port}}}
options: {{description: grbl}} # or grblhal, scpi-stage, or the path of a description of your own
axes:
  x:
    motors: [X] # X, Y or Z
    unit: mm
    scale: 250 # steps per mm, compared with $100
    soft_limits: {{min: -180, max: 0}} # from 0, where homing ends, away from the switch, which is in positive direction
    limits: {{velocity: 8 mm/s, acceleration: 10 mm/s²}} # compared with $110 and $120
    homing: {{direction: positive, timeout_s: 90}} # compared with $23
  y:
    motors: [Y]
    unit: mm
    scale: 250
    soft_limits: {{min: -180, max: 0}}
    limits: {{velocity: 8 mm/s, acceleration: 10 mm/s²}}
    homing: {{direction: positive, timeout_s: 90}}
"""


class AsciiOptions(LineOptions):
    """Options of a described controller."""

    description: str = Field(
        default="grbl", min_length=1, max_length=500, description="A packaged description, or the path of a file."
    )
    reference: dict[str, float] = Field(
        default={},
        description="By motor: the position that the controller has at the reference, in its own unit, where it is not "
        "that of the description.",
    )


class AsciiMake:
    """Controllers with simple text lines that a file describes: started by the host, moving in trapezoids."""

    api_version = API_VERSION
    searches_by_direction = True

    @property
    def name(self) -> str:
        return "ascii"

    @property
    def options_model(self) -> type[BaseModel]:
        return AsciiOptions

    def check_config(self, config: Controller) -> None:
        options = validate_options(AsciiOptions, config)
        try:
            description = load_description(options.description)
        except DescriptionError as error:
            raise ConfigError([f"options.description: {error}"]) from None
        problems: list[str] = []
        for name, axis in config.axes.items():
            if axis.motors[0] not in description.motors:
                known_motors = ", ".join(description.motors)
                problems.append(f"axes.{name}.motors: {axis.motors[0]!r} is none of {known_motors}")
            resolution = float(axis.scale) * 10.0**-description.report_decimals
            if description.positions == "units" and resolution >= 1:
                problems.append(
                    f"axes.{name}.scale: {float(axis.scale):g} counts per unit; the controller reports "
                    f"{description.report_decimals} decimals, so that counts cannot be told apart"
                )
        if any(motor not in description.motors for motor in options.reference):
            problems.append(f"options.reference: names motors that are none of {', '.join(description.motors)}")
        require_no_problems(problems)

    def fleet_example(self, place: ExamplePlace) -> str:
        return _EXAMPLE.format(port=place.own_port)

    @property
    def serial_defaults(self) -> Mapping[str, Any]:
        return {"baud": 115_200}

    def create_driver(self, setup: DriverSetup) -> LineDriver:
        options = setup.options
        assert isinstance(options, AsciiOptions)
        description = load_description(options.description)
        scales = {name: _make_scale(description, options, setup.config, name) for name in setup.config.axes}
        return LineDriver(setup, options, DescribedDialect(description, setup.config), scales)

    def make_decoder(self, options: Mapping[str, Any]) -> FrameDecoder:
        return DescribedDecoder(load_description(AsciiOptions.model_validate(options).description))

    def stop_bytes(self, config: Controller) -> bytes:
        options = AsciiOptions.model_validate(config.options)
        dialect = DescribedDialect(load_description(options.description), config)
        return dialect.stop_bytes + dialect.spoiler + dialect.stop_bytes


def _make_scale(description: Description, options: AsciiOptions, config: Controller, name: str) -> CountScale:
    axis = config.axes[name]
    per_unit = float(axis.scale) if description.positions == "units" else 1.0
    reference = options.reference.get(axis.motors[0], description.reference)
    return CountScale(per_unit, reference * per_unit)


MAKE = AsciiMake()

__all__ = ["MAKE", "AsciiMake", "AsciiOptions", "packaged_names"]
