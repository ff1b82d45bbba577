"""What a job says about a program in G-code: its dialect, and what stands for the machine that it was written for."""

import re
from typing import Annotated, Literal

from pydantic import Field, field_validator

from orchestrator.model.base import Model
from orchestrator.model.frame import MAX_COORDINATES
from orchestrator.model.units import Quantity

_SYSTEM = re.compile(r"G5[4-9]|G59\.[123]|G28|G30")

Point = Annotated[list[Quantity], Field(min_length=1, max_length=MAX_COORDINATES)]


class PauseInput(Model):
    """An input that ends a pause of a program."""

    input: str = Field(description="controller.input")
    timeout: str = Field(default="1 h", max_length=60, description="How long it is waited for.")


class GcodeSettings(Model):
    """What stands for the machine that a program was written for. Without an entry, a program that needs it is
    refused."""

    dialect: Literal["linuxcnc", "grbl", "marlin", "fanuc"] = Field(
        default="linuxcnc", description="Whose meanings codes have that have several."
    )
    spindle: Literal["none"] | None = Field(
        default=None, description="`none`: M3, M4, M5 and S are skipped; there is no spindle, or a person sees to it."
    )
    tools: Annotated[str, Field(min_length=1, max_length=4096)] | None = Field(
        default=None,
        description="`none`: T, M6 and G43 are skipped; there is one tool, or a person sees to it. Else LinuxCNC's "
        "tool table (.tbl) beside the job file: G43 takes lengths from it, in mm.",
    )
    coolant: Literal["none"] | None = Field(default=None, description="`none`: M7 and M8 are skipped.")
    pause: Literal["none"] | PauseInput | None = Field(
        default=None, description="At M0, M1 and M60: `none` goes on without a stop; or an input that ends the pause."
    )
    block_delete: Literal["skip", "run"] | None = Field(
        default=None, description="Whether lines that begin with / are skipped or run."
    )
    offsets: dict[str, Point] = Field(
        default={},
        max_length=11,
        description="Where the axes are at the zero of G54 to G59.3, and where G28 and G30 go: one value for each axis "
        "of the path, in their order. G54 without an entry is at 0.",
    )

    @field_validator("offsets")
    @classmethod
    def _check_names(cls, value: dict[str, Point]) -> dict[str, Point]:
        for name in value:
            if _SYSTEM.fullmatch(name) is None:
                raise ValueError(f"{name[:40]!r} is no work offset; write G54 to G59, G59.1 to G59.3, G28 or G30")
        return value
