"""The identity and the capabilities of a controller, as they are published."""

from functools import cache
from typing import Any

from pydantic import BaseModel

from adapters.abilities import LimitProbeDriver, LineProbeDriver, ProbeDriver
from adapters.contract import ControllerIdentity
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.host_ability import find_host_ability
from orchestrator.model.state import ControllerInfo
from orchestrator.model.version import PROTOCOL, find_own_version


def make_info(context: ControllerContext, identity: ControllerIdentity | None) -> ControllerInfo:
    """What a controller is and can do. identity: None while it has not been connected."""
    driver, config = context.driver, context.config
    capabilities = driver.capabilities
    return ControllerInfo(
        controller=context.controller,
        instance=context.instance,
        make=context.make.name,
        model=identity.model if identity else "",
        firmware=identity.firmware if identity else "",
        serial=identity.serial if identity else "",
        axes={name: axis.to_plain() for name, axis in config.axes.items()},
        start_classes=list(capabilities.start_classes),
        orders=list(capabilities.orders),
        independent_axes=capabilities.independent_axes,
        costs=capabilities.costs,
        chunk_s=capabilities.chunk_s,
        chunk_load_s=capabilities.chunk_load_s,
        chunk_triggers=capabilities.chunk_triggers,
        retarget=capabilities.retarget,
        alone_s=capabilities.alone_s,
        jog_ramps=capabilities.jog_ramps,
        shows_inputs=capabilities.shows_inputs,
        probe=driver.probe_ability if isinstance(driver, ProbeDriver) else None,
        limit_probe=driver.limit_ability if isinstance(driver, LimitProbeDriver) else None,
        line_probe=driver.line_ability if isinstance(driver, LineProbeDriver) else None,
        host_probe=find_host_ability(driver, config),
        digest=config.digest,
        options_schema=_options_schema(context.make.options_model),
        tutti=find_own_version(),
        protocol=str(PROTOCOL),
        certificate=context.certificate,
    )


@cache
def _options_schema(options: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON Schema of a make's options, which takes pydantic some milliseconds each time."""
    return options.model_json_schema()
