"""Codes that say where the numbers of a program are: work offsets, lengths of tools, shifts, places to go to."""

from collections.abc import Callable, Mapping
from typing import Any

from orchestrator.model.paths.files.gcode.errors import LineError
from orchestrator.model.paths.files.gcode.line import LETTERS, CodeLine
from orchestrator.model.paths.files.gcode.motions import Machine, take_words
from orchestrator.model.paths.files.gcode.notes import SkipNotes
from orchestrator.model.paths.files.gcode.offsets import SYSTEMS
from orchestrator.model.paths.gcode_settings import GcodeSettings, ToolChange
from orchestrator.model.paths.origin import Place
from orchestrator.model.units import Unit, UnitError, parse_quantity


class OffsetRunner:
    """Runs the codes of offsets. tools: of the tool table; places: of the mapping, mm, by name and letter."""

    def __init__(
        self,
        machine: Machine,
        settings: GcodeSettings,
        tools: Mapping[int, Mapping[str, float]] | None,
        notes: SkipNotes,
        places: Mapping[str, Mapping[str, float]],
    ) -> None:
        self._machine = machine
        self._settings = settings
        self._tools = tools
        self._notes = notes
        self._places = places
        offsets = machine.offsets
        self._axis_codes: Mapping[str, Callable[[CodeLine], None]] = {
            "G10": self._place_system,
            "G52": self._shift,
            "G92": self._shift,
            "G92.1": lambda _: offsets.end_shift(forget=True),
            "G92.2": lambda _: offsets.end_shift(forget=False),
            "G92.3": lambda _: offsets.restore_shift(),
        }

    def change(self, line: CodeLine) -> None:
        """Run the codes of offsets of a line. Raises `LineError`."""
        system = line.find_code("system")
        if "length" in line.codes:
            self._change_length(line)
        if system:
            self._machine.offsets.choose_system(system)
        code = line.find_code("axes")
        if code in self._axis_codes:
            self._axis_codes[code](line)

    def has_tool(self, number: int) -> bool:
        """Whether the tool table, if there is one, has a tool; 0 is none."""
        return self._tools is None or number == 0 or number in self._tools

    def _change_length(self, line: CodeLine) -> None:
        code, word = line.codes["length"]
        self._machine.modes.tool_length = code.name
        if code.name == "G49":
            self._notes.skip("G49")
            self._machine.offsets.choose_tool({})
        elif code.name == "G43.1":
            self._machine.offsets.choose_tool(take_words(line, self._machine, "G43.1"))
        else:
            if isinstance(self._settings.tools, ToolChange) and self._tools is None:
                raise LineError(word.column, "G43 needs lengths: `gcode: {tools: {change: …, table: tools.tbl}}`")
            self._notes.require_entry(self._settings, "tools", "G43", word)
            number = line.take_number("H", "the tool of G43")
            number = self._machine.modes.tool if number is None else number
            if self._tools is None:
                return
            if number not in self._tools:
                raise LineError(word.column, f"the tool table has no tool {number}")
            self._machine.offsets.choose_tool(self._tools[number])

    def _place_system(self, line: CodeLine) -> None:
        kind = line.require("L", "G10", "L2 or L20")
        number = line.require("P", "G10", "P with the number of a work offset")
        if kind.value not in (2, 20):
            raise LineError(kind.column, f"G10 L{kind.value:g} is not supported; L2 and L20 are")
        name = self._machine.offsets.name_system(number.value)
        values = take_words(line, self._machine, "G10")
        if kind.value == 2:
            self._machine.offsets.place_system(name, values)
        else:
            self._machine.offsets.place_point(name, values, self._machine.at)

    def _shift(self, line: CodeLine) -> None:
        name = line.find_code("axes")
        values = take_words(line, self._machine, name)
        if not values:
            raise LineError(line.codes["axes"][1].column, f"{name} needs words of axes")
        if name == "G52":
            self._machine.offsets.shift(values)
        else:
            self._machine.offsets.shift_to(values, self._machine.at)

    def go_home(self, line: CodeLine, name: str, place: Place) -> None:
        """G28 and G30: by the point that is given, if one is, to a place of the mapping; with all axes, or those that
        are named."""
        values = take_words(line, self._machine, name)
        if name not in self._places:
            points = ", ".join("0" for _ in self._machine.letters)
            text = f"where {name} goes is not known: write `gcode: {{offsets: {{{name}: [{points}]}}}}`"
            raise LineError(line.codes["axes"][1].column, text)
        if values:
            self._machine.go(self._machine.find_target(values), place, is_rapid=True)
        letters = list(values) or self._machine.letters
        target = {letter: self._places[name][letter] for letter in letters}
        self._machine.go({**self._machine.at, **target}, place, is_rapid=True)

    def find_state(self, name: int | str) -> float | None:
        """What a program may read of the machine, by the name or number of a parameter; None: it may not."""
        modes, scale = self._machine.modes, self._machine.modes.scale
        if isinstance(name, int):
            if name == 5220:
                return SYSTEMS.index(self._machine.offsets.system) + 1.0
            letter = LETTERS[name - 5420] if 5420 <= name < 5420 + len(LETTERS) else ""
        else:
            letter = name[1:].upper() if len(name) == 2 else ""
        if letter in self._machine.at and letter:
            return (self._machine.at[letter] - self._machine.offsets.total[letter]) / scale
        values: Mapping[int | str, float | None] = {
            "_feed": None if modes.feed is None else modes.feed / scale,
            "_rpm": modes.spindle_speed or 0.0,
            "_metric": float(scale == 1.0),
            "_imperial": float(scale != 1.0),
            "_absolute": float(not modes.is_relative),
            "_incremental": float(modes.is_relative),
            "_plane": float(modes.plane[1:]) * 10,
            "_motion_mode": float(modes.motion[1:]) * 10 if modes.motion else 800.0,
            "_current_tool": float(modes.tool),
            "_selected_tool": float(modes.selected_tool),
        }
        return values.get(name)


def read_places(settings: GcodeSettings, letters: list[str]) -> dict[str, dict[str, float]]:
    """The offsets of the mapping, mm, by letter. Raises `LineError`."""
    places: dict[str, dict[str, Any]] = {}
    for name, point in settings.offsets.items():
        if len(point) != len(letters):
            raise LineError(0, f"`offsets` of `gcode:`: {name} has {len(point)} values for {len(letters)} axes")
        try:
            places[name] = {
                letter: float(parse_quantity(value, Unit.MM, letter))
                for letter, value in zip(letters, point, strict=True)
            }
        except UnitError as error:
            raise LineError(0, f"`offsets` of `gcode:`: {error}") from None
    return places
