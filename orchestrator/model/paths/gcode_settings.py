"""What a job says about a program in G-code: its dialect, and what stands for the machine that it was written for."""

import re
from typing import Annotated, Literal

from pydantic import Field, field_validator

from orchestrator.model.base import Model
from orchestrator.model.frame import MAX_COORDINATES
from orchestrator.model.numbers import Duration
from orchestrator.model.units import Quantity

_SYSTEM = re.compile(r"G5[4-9]|G59\.[123]|G28|G30")

Point = Annotated[list[Quantity], Field(min_length=1, max_length=MAX_COORDINATES)]


class PauseInput(Model):
    """An input that ends a pause of a program."""

    input: str = Field(description="controller.input")
    timeout: str = Field(default="1 h", max_length=60, description="How long it is waited for.")


Wait = Annotated[Duration, Field(description="After a change, before the axes move.")]


class SpindleOutputs(Model):
    """Outputs that switch a spindle."""

    forward: str = Field(description="controller.output that M3 switches on.")
    reverse: str | None = Field(default=None, description="That of M4; without it M4 is refused.")
    speed: float | None = Field(
        default=None, gt=0, description="Turns a minute that it has; another S is refused. Without it S is skipped."
    )
    wait: Wait = 0

    @property
    def outputs(self) -> list[str]:
        """All of them."""
        return [output for output in (self.forward, self.reverse) if output is not None]


class CoolantOutputs(Model):
    """Outputs that switch coolant; a code without one is refused."""

    mist: str | None = Field(default=None, description="controller.output that M7 switches on.")
    flood: str | None = Field(default=None, description="That of M8.")
    wait: Wait = 0

    @property
    def outputs(self) -> list[str]:
        """All of them."""
        return [output for output in (self.mist, self.flood) if output is not None]


class ToolChange(Model):
    """A person changes tools."""

    change: PauseInput = Field(description="M6 stops the spindle, and waits for this input.")
    table: Annotated[str, Field(min_length=1, max_length=4096)] | None = Field(
        default=None, description="LinuxCNC's tool table (.tbl) beside the job file."
    )


class ProbeInput(Model):
    """What a probe of a program moves until."""

    input: str = Field(description="controller.input, of the same controller as the axis that probes.")
    by: Literal["controller", "host"] = Field(default="controller", description="As `by` of a step `do: probe`.")


class GcodeSettings(Model):
    """What stands for the machine that a program was written for. Without an entry, a program that needs it is
    refused."""

    dialect: Literal["linuxcnc", "grbl", "marlin", "fanuc"] = Field(
        default="linuxcnc", description="Whose meanings codes have that have several."
    )
    spindle: Literal["none"] | SpindleOutputs | None = Field(
        default=None,
        description="`none`: M3, M4, M5 and S are skipped; there is no spindle, or a person sees to it. Or the outputs "
        "that switch it, which the end of the program switches off.",
    )
    tools: Annotated[str, Field(min_length=1, max_length=4096)] | ToolChange | None = Field(
        default=None,
        description="`none`: T, M6 and G43 are skipped; there is one tool, or a person sees to it. Else LinuxCNC's "
        "tool table (.tbl) beside the job file: G43 takes lengths from it, in mm. Or what M6 waits for.",
    )
    coolant: Literal["none"] | CoolantOutputs | None = Field(
        default=None, description="`none`: M7 and M8 are skipped. Or the outputs that switch it."
    )
    pause: Literal["none"] | PauseInput | None = Field(
        default=None, description="At M0, M1 and M60: `none` goes on without a stop; or an input that ends the pause."
    )
    probe: str | ProbeInput | None = Field(
        default=None, description="The input (controller.input) that G38.2 to G38.5 move until."
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

    @property
    def tool_table(self) -> str | None:
        """The file with the lengths of tools."""
        if isinstance(self.tools, ToolChange):
            return self.tools.table
        return None if self.tools == "none" else self.tools

    @field_validator("offsets")
    @classmethod
    def _check_names(cls, value: dict[str, Point]) -> dict[str, Point]:
        for name in value:
            if _SYSTEM.fullmatch(name) is None:
                raise ValueError(f"{name[:40]!r} is no work offset; write G54 to G59, G59.1 to G59.3, G28 or G30")
        return value
