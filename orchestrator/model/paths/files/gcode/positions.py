"""Codes that say where the numbers of a program are: work offsets, lengths of tools, shifts, places to go to."""

from collections.abc import Callable, Mapping
from typing import Any

from orchestrator.model.paths.files.gcode.contacts import MeasuredZero
from orchestrator.model.paths.files.gcode.errors import LineError
from orchestrator.model.paths.files.gcode.line import LETTERS, CodeLine
from orchestrator.model.paths.files.gcode.motions import Machine, take_words
from orchestrator.model.paths.files.gcode.notes import SkipNotes
from orchestrator.model.paths.files.gcode.offsets import SYSTEMS
from orchestrator.model.paths.files.gcode.probing import ProbeRunner
from orchestrator.model.paths.gcode_settings import GcodeSettings, ToolChange
from orchestrator.model.paths.origin import Place
from orchestrator.model.units import Unit, UnitError, parse_quantity


class OffsetRunner:
    """Runs the codes of offsets. probes: runs probes, whose contacts they give numbers. tools: of the tool table;
    places: of the mapping, mm, by name and letter."""

    def __init__(
        self,
        machine: Machine,
        settings: GcodeSettings,
        tools: Mapping[int, Mapping[str, float]] | None,
        notes: SkipNotes,
        places: Mapping[str, Mapping[str, float]],
    ) -> None:
        self.probes = ProbeRunner(machine, settings, notes)
        self._machine = machine
        self._settings = settings
        self._tools = tools
        self._notes = notes
        self._places = places
        self._axis_codes: Mapping[str, Callable[[CodeLine, int], None]] = {
            "G10": self._place_system,
            "G52": self._shift,
            "G92": self._shift_to,
            "G92.1": self._end_shift,
            "G92.2": self._end_shift,
            "G92.3": lambda _, __: machine.offsets.restore_shift(),
        }

    def change(self, line: CodeLine, number: int) -> None:
        """Run the codes of offsets of line `number`. Raises `LineError`."""
        system = line.find_code("system")
        if "length" in line.codes:
            self._change_length(line)
        if system:
            self._machine.contacts.require_system(system)
            self._machine.offsets.choose_system(system)
        code = line.find_code("axes")
        if code not in self._axis_codes:
            return
        if code in ("G52", "G92.1", "G92.2", "G92.3"):
            self._machine.contacts.require_own_zero(self._machine.letters, code)
        self._axis_codes[code](line, number)

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

    def _place_system(self, line: CodeLine, line_number: int) -> None:
        kind = line.require("L", "G10", "L2 or L20")
        number = line.require("P", "G10", "P with the number of a work offset")
        if kind.value not in (2, 20):
            raise LineError(kind.column, f"G10 L{kind.value:g} is not supported; L2 and L20 are")
        name = self._machine.offsets.name_system(number.value)
        values = take_words(line, self._machine, "G10")
        if kind.value == 2:
            self._machine.contacts.require_own_zero(values, "G10 L2")
            self._machine.offsets.place_system(name, values)
        else:
            values = self._set_zeros(values, MeasuredZero("G10", name, line_number))
            self._machine.offsets.place_point(name, values, self._machine.at)

    def _shift(self, line: CodeLine, _: int) -> None:
        self._machine.offsets.shift(self._take_shifts(line, "G52"))

    def _shift_to(self, line: CodeLine, line_number: int) -> None:
        zero = MeasuredZero("G92", self._machine.offsets.system, line_number)
        values = self._set_zeros(self._take_shifts(line, "G92"), zero)
        self._machine.offsets.shift_to(values, self._machine.at)

    def _end_shift(self, line: CodeLine, _: int) -> None:
        self._machine.offsets.end_shift(forget=line.find_code("axes") == "G92.1")

    def _take_shifts(self, line: CodeLine, name: str) -> dict[str, float]:
        values = take_words(line, self._machine, name)
        if not values:
            raise LineError(line.codes["axes"][1].column, f"{name} needs words of axes")
        return values

    def _set_zeros(self, values: Mapping[str, float], zero: MeasuredZero) -> dict[str, float]:
        """Set the zeros of axes that stand beside a contact; return the values of the others."""
        measured_letters = [letter for letter in values if letter in self._machine.contacts.present]
        for letter in measured_letters:
            self.probes.set_zero(letter, values[letter], zero)
        return {letter: value for letter, value in values.items() if letter not in measured_letters}

    def go_home(self, line: CodeLine, name: str, place: Place) -> None:
        """G28 and G30: by the point that is given, if one is, to a place of the mapping; with all axes, or those that
        are named."""
        values = take_words(line, self._machine, name)
        if name not in self._places:
            points = ", ".join("0" for _ in self._machine.letters)
            text = f"where {name} goes is not known: write `gcode: {{offsets: {{{name}: [{points}]}}}}`"
            raise LineError(line.codes["axes"][1].column, text)
        letters = list(values) or self._machine.letters
        self._machine.contacts.require_own_zero(letters, name)
        if values:
            fixed_letters = self._machine.list_fixed(values)
            self._machine.go(self._machine.find_target(values), place, is_rapid=True, fixed=fixed_letters)
        target = {letter: self._places[name][letter] for letter in letters}
        self._machine.go({**self._machine.at, **target}, place, is_rapid=True, fixed=letters)

    def find_state(self, name: int | str) -> float | None:
        """What a program may read of the machine, by the name or number of a parameter; None: it may not."""
        modes, scale = self._machine.modes, self._machine.modes.scale
        if isinstance(name, int):
            if name == 5220:
                return SYSTEMS.index(self._machine.offsets.system) + 1.0
            if (contact_value := self.probes.find_state(name)) is not None:
                return contact_value
            letter = LETTERS[name - 5420] if 5420 <= name < 5420 + len(LETTERS) else ""
        else:
            letter = name[1:].upper() if len(name) == 2 else ""
        if letter in self._machine.at and letter:
            if letter in self._machine.contacts.present:
                self._machine.contacts.require_known("a parameter")
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
