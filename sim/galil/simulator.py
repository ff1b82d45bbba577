"""The two simulated families, and their options."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

from orchestrator.model.fleet import Controller
from sim.galil.record import DMC2103, DMC4000, make_commands
from sim.yaskawa.base.options import Smc4000Options
from sim.yaskawa.machine.model import ControllerModel
from sim.yaskawa.smc4000 import MODEL, SmcSimulator


class GalilOptions(Smc4000Options):
    """Options of a simulated Galil controller: those of an SMC-4000, and its family."""

    family: Literal["dmc21x3", "dmc40x0"] = "dmc40x0"


_MODELS = {
    "dmc21x3": replace(
        MODEL,
        name="dmc21x3",
        revision="DMC21{options.axes}3 Rev 1.0o",
        commands=MODEL.commands | make_commands(DMC2103),
    ),
    "dmc40x0": replace(
        MODEL,
        name="dmc40x0",
        revision="DMC40{options.axes}0 Rev 1.2a",
        commands=MODEL.commands | make_commands(DMC4000),
    ),
}


def _find_model(options: Smc4000Options) -> ControllerModel:
    return _MODELS[options.family if isinstance(options, GalilOptions) else "dmc40x0"]


def _find_family(config: Controller) -> Mapping[str, Any]:
    return {"family": config.options.get("family", "dmc40x0")}


GALIL = SmcSimulator("galil", GalilOptions, _find_model, _find_family)
