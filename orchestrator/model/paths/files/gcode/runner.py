"""What a line does, in LinuxCNC's order: feed, spindle, tool, dwell, modes, offsets, motion, end."""

from collections.abc import Mapping

from orchestrator.model.paths.files.base.imported import format_number
from orchestrator.model.paths.files.gcode.codes import CYCLES, DIALECTS
from orchestrator.model.paths.files.gcode.cycles import CycleRunner
from orchestrator.model.paths.files.gcode.errors import LineError
from orchestrator.model.paths.files.gcode.line import LETTERS, CodeLine
from orchestrator.model.paths.files.gcode.modes import INCH_MM, Modes
from orchestrator.model.paths.files.gcode.motions import Machine, make_arc, take_words
from orchestrator.model.paths.files.gcode.notes import SkipNotes
from orchestrator.model.paths.files.gcode.offsets import WorkOffsets
from orchestrator.model.paths.files.gcode.outputs import OutputRunner
from orchestrator.model.paths.files.gcode.positions import OffsetRunner, read_places
from orchestrator.model.paths.files.gcode.probing import PROBES
from orchestrator.model.paths.files.gcode.writer import StepWriter
from orchestrator.model.paths.gcode_settings import GcodeSettings, PauseInput
from orchestrator.model.paths.origin import Place

_SKIPPED_GROUPS = ("cutter", "spindle mode", "override", "skipped 1")
_CENTRES = "IJK"


class LineRunner:
    """Runs the lines of a program, one after the other. writer: what they make; notes: what they skip."""

    def __init__(
        self,
        axes: Mapping[str, str],
        start: Mapping[str, float],
        settings: GcodeSettings,
        tools: Mapping[int, Mapping[str, float]] | None,
    ) -> None:
        self.writer = StepWriter(axes, start)
        self.notes = SkipNotes()
        self._settings = settings
        self._dialect = DIALECTS[settings.dialect]
        self._outputs = OutputRunner(settings, self.writer, self.notes)
        self._modes = Modes()
        places = read_places(settings, list(axes))
        self._offsets = WorkOffsets(list(axes), places)
        self._machine = Machine(
            list(axes), self._modes, self._offsets, self.writer, dict(self.writer.point), self._dialect.has_rapids
        )
        self._cycles = CycleRunner(self._machine, self._dialect.dwell["P"])
        self._positions = OffsetRunner(self._machine, settings, tools, self.notes, places)

    def run(self, line: CodeLine, number: int) -> bool:
        """Run a line; False: the program ends with it. Raises `LineError`."""
        line_place = Place(number, self._find_column(line))
        self._check_letters(line)
        if line.codes:
            self._skip(line)
        self._change_feed(line)
        self._change_tool(line)
        if line.codes:
            self._outputs.run(line)
            if "dwell" in line.codes:
                self._dwell(line)
            self._change_modes(line)
            self._positions.change(line, number)
        self._move(line, line_place)
        line.finish()
        return "end" not in line.codes or self._end(line)

    def begin_here(self) -> list[str]:
        """Forget the steps before, and begin with a move to where the program stands; its modes in words. Raises
        `LineError` if that is measured."""
        self._machine.contacts.require_known("to begin here")
        self.writer.forget()
        for step in (*self._outputs.list_active(), self.writer.move_here()):
            self.writer.add_step(step)
        zeros = [
            f"zero of {letter} as line {zero.line} has set it at a contact"
            for letter, zero in self._machine.contacts.zeros.items()
        ]
        return [*self._modes.describe(self._offsets.system), *zeros]

    def finish(self) -> None:
        """The program has ended."""
        self._outputs.end()
        self.writer.end_path()

    def find_state(self, name: int | str) -> float | None:
        """What a program may read of the machine, by the name or number of a parameter; None: it may not."""
        return self._positions.find_state(name)

    # Words that are not of a motion

    def _find_column(self, line: CodeLine) -> int:
        if "motion" in line.codes:
            return line.codes["motion"][1].column
        return min((word.column for word in line.letters.values()), default=1)

    def _check_letters(self, line: CodeLine) -> None:
        for letter, word in line.letters.items():
            if letter in LETTERS and letter not in self._machine.at and letter not in self._dialect.dwell:
                axis = f"name it: --axis {letter}=CONTROLLER.AXIS"
                raise LineError(word.column, f"no axis is named for {letter}; {axis}")

    def _skip(self, line: CodeLine) -> None:
        for group in _SKIPPED_GROUPS:
            if group in line.codes:
                self.notes.skip(line.codes[group][0].name)

    def _change_feed(self, line: CodeLine) -> None:
        modes = self._modes
        mode = line.find_code("feed mode")
        if mode and mode != modes.feed_mode:
            modes.feed_mode, modes.feed = mode, None
        if mode == "G94":
            self.notes.skip("G94")
        elif modes.feed_mode == "G93":
            modes.feed = None  # for one motion
        modes.spindle = line.find_code("spindle") or modes.spindle
        speed = None if "dwell" in line.codes and "S" in self._dialect.dwell else line.take("S", "the spindle")
        if speed is not None:
            self._outputs.check_speed(speed)
            modes.spindle_speed = speed.value
        feed = line.take("F", "the feed")
        if feed is not None:
            if feed.value <= 0:
                raise LineError(feed.column, f"a feed must be above 0, not {feed.value:g}")
            # That of the units of this line, as people mean it.
            units = line.find_code("units")
            scale = modes.scale if not units else INCH_MM if units == "G20" else 1.0
            modes.feed = feed.value * (1.0 if modes.feed_mode == "G93" else scale)

    def _change_tool(self, line: CodeLine) -> None:
        tool = line.take_number("T", "the tool")
        if tool is not None:
            word = line.letters["T"]
            self.notes.require_entry(self._settings, "tools", "T", word)
            if not self._positions.has_tool(tool):
                raise LineError(word.column, f"the tool table has no tool {tool}")
            self._modes.selected_tool = tool
        if "tool" in line.codes:
            self._outputs.change_tool(line.codes["tool"][1])
            self._modes.tool = self._modes.selected_tool

    def _dwell(self, line: CodeLine) -> None:
        units = self._dialect.dwell
        letters = [letter for letter in units if letter in line.letters]
        # An axis word of G4 is a time on some controls, and then it is no motion.
        word = line.take(letters[0], "the time of G4") if letters else None
        if word is None or word.value < 0:
            raise LineError(0, "G4 needs a time in seconds: write for example G4 P0.5")
        self.writer.add_dwell(word.value * units[word.letter])

    # Modes and offsets

    def _change_modes(self, line: CodeLine) -> None:
        modes = self._modes
        modes.plane = line.find_code("plane") or modes.plane
        units, distance, centres = (line.find_code(group) for group in ("units", "distance", "arc distance"))
        if units:
            modes.scale = INCH_MM if units == "G20" else 1.0
        if distance:
            modes.is_relative = distance == "G91"
        if centres:
            modes.has_absolute_centres = centres == "G90.1"
        if "return" in line.codes:
            modes.returns_to_r = line.find_code("return") == "G99"
        if "control" in line.codes:
            modes.corner = "stop" if line.find_code("control") != "G64" else self._read_corner(line)

    def _read_corner(self, line: CodeLine) -> dict[str, str] | None:
        """G64 P, and Q, by which a controller may leave points out: none is. Alone it allows any rounding: what the job
        says holds."""
        tolerance = line.take("P", "the tolerance of G64")
        point_tolerance = line.take("Q", "the tolerance of points of G64")
        if tolerance is None and point_tolerance is None:
            return None
        if tolerance is None or tolerance.value <= 0:
            raise LineError(0, "G64 needs a tolerance above 0: write for example G64 P0.05")
        return {"within": f"{format_number(tolerance.value * self._modes.scale)} mm"}

    # Motion and end

    def _move(self, line: CodeLine, place: Place) -> None:
        modes = self._modes
        code = line.find_code("axes")
        motion = line.find_code("motion")
        if "cycle end" in line.codes:
            self.notes.skip("G80")
            modes.motion = ""
        if motion:
            modes.motion = motion
        if modes.motion != self._cycles.cycle:
            self._cycles.end()
        if code in ("G28", "G30"):
            self._positions.go_home(line, code, place)
        elif self._moves(line, motion):
            self._run_motion(line, place)
        elif "machine" in line.codes:
            raise LineError(line.codes["machine"][1].column, "G53 needs G0 or G1, and words of axes")

    def _moves(self, line: CodeLine, motion: str) -> bool:
        is_arc = self._modes.motion in ("G2", "G3")
        return (
            line.has_any(self._machine.letters)
            or (is_arc and (line.has_any(_CENTRES) or line.has_any("R")))
            or ((motion in CYCLES or motion in PROBES) and not line.find_code("axes"))
        )

    def _run_motion(self, line: CodeLine, place: Place) -> None:
        name, machine = self._modes.motion, self._machine
        if not name:
            raise LineError(0, "no motion is chosen; begin with G0, G1, G2 or G3")
        is_machine = "machine" in line.codes
        if is_machine and (name not in ("G0", "G1") or self._modes.is_relative):
            raise LineError(line.codes["machine"][1].column, "G53 needs G0 or G1, and G90")
        if name in ("G0", "G1"):
            words = take_words(line, machine, name)
            if is_machine:
                machine.contacts.require_own_zero(words, "G53")
            fixed_letters = machine.list_fixed(words, is_machine=is_machine)
            machine.go(
                machine.find_target(words, is_machine=is_machine), place, is_rapid=name == "G0", fixed=fixed_letters
            )
        elif name in PROBES:
            self._positions.probes.run(line, place)
        else:
            machine.contacts.require_known(name)
            if name in CYCLES:
                self._cycles.run(line, place)
            else:
                make_arc(line, machine, place)

    def _end(self, line: CodeLine) -> bool:
        code, word = line.codes["end"]
        if code.name in ("M2", "M30"):
            self.notes.skip(code.name)
            return False
        pause = self._settings.pause
        if pause is None:
            text = (
                f"{code.name} waits for a person: write `gcode: {{pause: {{input: CONTROLLER.INPUT}}}}` with the input"
            )
            raise LineError(word.column, f"{text} that ends the pause, or `gcode: {{pause: none}}` to go on without it")
        if isinstance(pause, PauseInput):
            self.writer.add_step({"do": "wait", "input": pause.input, "timeout": pause.timeout})
        else:
            self.notes.skip_by_entry(code.name)
        return True
