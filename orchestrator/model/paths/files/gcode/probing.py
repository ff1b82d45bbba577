"""Probing in a program: G38.2 to G38.5, as GRBL and LinuxCNC define them, and zeros at a contact."""

from collections.abc import Mapping
from math import hypot
from typing import Any, NamedTuple

from orchestrator.model.paths.files.base.imported import format_number
from orchestrator.model.paths.files.gcode.contacts import Contact, MeasuredZero
from orchestrator.model.paths.files.gcode.errors import LineError
from orchestrator.model.paths.files.gcode.line import CodeLine
from orchestrator.model.paths.files.gcode.motions import Machine, take_words
from orchestrator.model.paths.files.gcode.notes import SkipNotes
from orchestrator.model.paths.gcode_settings import GcodeSettings, ProbeInput
from orchestrator.model.paths.origin import Place

CONTACTS, SUCCESS = range(5061, 5070), 5070
"""The parameters in which LinuxCNC has the contact, and whether there is one."""


class Probe(NamedTuple):
    """What a code does. level: what its input becomes. is_certain: the program ends if it does not."""

    level: str
    is_certain: bool


PROBES: Mapping[str, Probe] = {
    "G38.2": Probe("active", is_certain=True),
    "G38.3": Probe("active", is_certain=False),
    "G38.4": Probe("passive", is_certain=True),
    "G38.5": Probe("passive", is_certain=False),
}


class ProbeRunner:
    """Runs probes, and sets zeros at contacts."""

    def __init__(self, machine: Machine, settings: GcodeSettings, notes: SkipNotes) -> None:
        self._machine = machine
        self._settings = settings
        self._notes = notes
        self._last: Probe | None = None

    def run(self, line: CodeLine, place: Place) -> None:
        """Move axes on a straight line to the place of a line of the program until the input of the probe changes, and
        back to the contact; other axes stand. Raises `LineError`."""
        machine, name = self._machine, self._machine.modes.motion
        probe_input = self._read_input(name, place)
        words = take_words(line, machine, name)
        to, fixed_letters = machine.find_target(words), machine.list_fixed(words)
        letters = machine.list_moved(to, fixed_letters)
        if not letters:
            raise LineError(place.column, f"{name} moves no axis")
        if len(letters) > 1 and probe_input.by == "host":
            text = f"{name} moves {' and '.join(letters)}, and a computer stops one axis at a time"
            raise LineError(place.column, f"{text}; move one, or leave `by: host` out")
        for letter in letters:
            if letter in machine.contacts.present and letter not in fixed_letters:
                self._require_certain(letter, name)
        length = hypot(*(to[letter] - machine.at[letter] for letter in letters))
        speed, probe = f"{format_number(machine.find_speed(length))} mm/s", PROBES[name]
        contacts = {letter: Contact(f"line {place.line}", to[letter], probe.is_certain) for letter in letters}
        self._last, contact = probe, contacts[letters[0]]
        step: dict[str, Any] = {
            "do": "probe",
            "name": contact.name,
            **machine.make_targets(to, letters, fixed_letters),
            "until": probe_input.input,
            "by": probe_input.by,
            "level": self._last.level,
            "speed": speed,
            "else": "fail" if contact.is_certain else "continue",
        }
        if not machine.writer.has_moved:
            step["start"] = machine.writer.list_places()
        machine.writer.add_step(step, place.line)
        machine.contacts.present |= contacts
        machine.at = to
        machine.writer.stand_at(to)
        if contact.is_certain:  # the axis has gone on, while it came to rest
            return_targets = machine.make_targets(to, letters, ())
            step = {"do": "move", "name": f"{contact.name}: to the contact", **return_targets, "speed": speed}
            if len(letters) > 1:
                step["sync"] = "phase"
            machine.writer.add_step(step, place.line)
        self._notes.act_by_entry(name)

    def set_zero(self, letter: str, number: float, zero: MeasuredZero) -> None:
        """Give the present position of an axis, which is measured, a number of the program. Raises `LineError`."""
        machine = self._machine
        if zero.code == "G10" and zero.system != machine.offsets.system:
            text = f"the zero of {letter} at a contact is that of {machine.offsets.system}, which is chosen"
            raise LineError(0, f"{text}; choose {zero.system} before")
        position = number + machine.offsets.total[letter]
        axis = machine.writer.find_axes([letter])[0]
        machine.writer.add_step({"do": "set-position", "axes": {axis: f"{format_number(position)} mm"}}, zero.line)
        del machine.contacts.present[letter]
        machine.contacts.zeros[letter] = zero
        machine.at = {**machine.at, letter: position}
        machine.writer.stand_at(machine.at)
        self._notes.keep(f"line {zero.line} sets the user position of {axis}, which stays behind the program")

    def find_state(self, number: int) -> float | None:
        """A parameter of the last probe; None: there is none. Raises `LineError` for what is measured."""
        if self._last is None or (number != SUCCESS and number not in CONTACTS):
            return None
        if number == SUCCESS and self._last.is_certain:
            return 1.0
        text = f"#{number} is measured when the program runs, and its lines are read before"
        raise LineError(0, f"{text}; set the zero at the contact (G92, G10 L20), and go on from there")

    def _read_input(self, name: str, place: Place) -> ProbeInput:
        probe = self._settings.probe
        if probe is None:
            text = f"{name} needs the input of the probe: write `gcode: {{probe: CONTROLLER.INPUT}}`"
            raise LineError(place.column, text)
        return ProbeInput(input=probe) if isinstance(probe, str) else probe

    def _require_certain(self, letter: str, name: str) -> None:
        if not self._machine.contacts.present[letter].is_certain:
            text = f"{name} would end so far from where {letter} stands, which is not known behind G38.3 and G38.5"
            raise LineError(0, f"{text}; go to a place before (G90 G0 {letter}…)")
