"""The modes of a program: they hold until they are changed."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

INCH_MM = 25.4


class Plane(NamedTuple):
    """A plane: its two letters, the offsets of centres along them, and the letter across."""

    first: str
    second: str
    first_offset: str
    second_offset: str
    across: str


PLANES: Mapping[str, Plane] = {
    "G17": Plane("X", "Y", "I", "J", "Z"),
    "G18": Plane("Z", "X", "K", "I", "Y"),
    "G19": Plane("Y", "Z", "J", "K", "X"),
}


@dataclass(slots=True)
class Modes:
    """All modes. scale: mm of a unit of the program. feed: a number of F in mm, or passes per minute with G93, mm per
    turn with G95. spindle: the last of M3, M4 and M5. corner: None: the program has not chosen."""

    motion: str = ""
    plane: str = "G17"
    scale: float = 1.0
    is_relative: bool = False
    has_absolute_centres: bool = False
    feed_mode: str = "G94"
    feed: float | None = None
    spindle: str = "M5"
    spindle_speed: float | None = None
    corner: str | dict[str, str] | None = None
    returns_to_r: bool = False
    selected_tool: int = 0
    tool: int = 0
    tool_length: str = "G49"

    def describe(self, system: str) -> list[str]:
        """The modes in words, as the start of a part of a program takes them over."""
        feed_unit = {"G93": "passes a minute", "G95": "mm a turn"}.get(self.feed_mode, "mm/min")
        return [
            f"work offset {system}",
            f"tool {self.tool or 'none'}{'' if self.tool_length == 'G49' else ', with its length'}",
            "spindle off" if self.spindle == "M5" else f"spindle {self.spindle} S{self.spindle_speed or 0:g}",
            "no feed" if self.feed is None else f"feed {self.feed:g} {feed_unit}",
            f"plane {self.plane}",
            f"units {'inch (G20)' if self.scale != 1.0 else 'mm (G21)'}",
            f"{'increments (G91)' if self.is_relative else 'absolute (G90)'}",
            f"motion {self.motion or 'none'}",
        ]
