"""The `options:` of a Galil controller in the fleet file."""

from typing import Literal

from pydantic import Field

from adapters.yaskawa.common.options import YaskawaOptions


class GalilOptions(YaskawaOptions):
    """Options of a Galil controller: those of an SMC-4000. The times of the firmware are assumptions, not measured."""

    family: Literal["dmc21x3", "dmc40x0"] = Field(
        default="dmc40x0", description="The family; another one is refused when the controller is connected."
    )
