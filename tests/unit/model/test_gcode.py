"""Programs in G-code: each word has one meaning or is refused; what real programs need; hostile ones."""

import gc
import random
import time
from math import hypot
from pathlib import Path
from typing import Any

import pytest
from unit.gcode_programs import ALL, AXES, STYLES, WordReader, add_checksum, mutate

from orchestrator.model.jobs.files import FileError
from orchestrator.model.jobs.job import Job
from orchestrator.model.paths.files.base.imported import ImportedSteps, make_job
from orchestrator.model.paths.files.gcode import flow
from orchestrator.model.paths.files.gcode.codes import CODES
from orchestrator.model.paths.files.gcode.reader import GcodeReader
from orchestrator.model.paths.files.reading import GcodeStart, read_path_file
from orchestrator.model.paths.gcode_settings import GcodeSettings

ROOT = Path(__file__).parents[3]
HOME = {"G28": [0, 0, 50], "G30": [0, 0, 60]}


def read(text: str, from_line: int = 1, start: dict[str, float] | None = None, **settings: Any) -> ImportedSteps:
    reader = GcodeReader("part.ngc", AXES, start, GcodeSettings.model_validate(settings))
    return reader.read_all(text.split("\n"), from_line)


def refuse(text: str, **settings: Any) -> str:
    with pytest.raises(FileError) as caught:
        read(text, **settings)
    return str(caught.value)


def points(text: str, **settings: Any) -> list[tuple[float, ...]]:
    """The ends of all pieces, mm."""
    steps = read(text, **settings).steps
    pieces = [piece for step in steps for piece in step.get("pieces", ())]
    return [tuple(float(value.removesuffix(" mm")) for value in piece["to"]) for piece in pieces]


# No word is dropped


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("F60 G0 G1 X1", "1: column 8: G1 and G0 are of one modal group"),
        ("M3 M5 G0 X1", "column 4: M5 and M3 are of one modal group"),
        ("M8 M9 G0 X1", "column 4: this line switches the coolant on and off"),
        ("F60 G1 X1 I2", "column 11: I2 has no meaning in this line"),
        ("F60 G1 X1 R2", "column 11: R2 has no meaning"),
        ("F60 G1 X1 P2", "column 11: P2 has no meaning"),
        ("F60 G1 X1 L2", "column 11: L2 has no meaning"),
        ("F60 G2 X2 R1 I1", "column 14: I1 has no meaning"),
        ("F60 G2 X2 I1 K1", "column 14: K1 has no meaning"),
        ("F60 G2 X2 I1 P1.5", "column 14: P of an arc is its number of turns"),
        ("F60 G2 X2 I1 P0", "P of an arc is its number of turns"),
        ("F60 G64 G2 X2 I1 P0.5", "P would be of the tolerance of G64 and of the turns of G2; write them in two lines"),
        ("F60 G4 G82 X1 Z-1 R1 P1", "P would be of the time of G4 and of G82"),
        ("G92 X1 G0 Y1 Q2", "Q2 has no meaning"),
        ("X1", "no motion is chosen"),
        ("G80 G81 X1 Z-1 R1", "column 1: G80 and G81 are of one modal group"),
        ("G80 X1", "no motion is chosen"),
        ("G53 G0", "G53 needs G0 or G1, and words of axes"),
        ("G53 G91 G0 X1", "G53 needs G0 or G1, and G90"),
        ("F60 G93 G1 X1\nX2", "2: each motion needs its F with G93"),
        ("G95 F1 G1 X1", "G95 is a feed per turn"),
        ("G38.2 Z-1 F10", "column 1: G38.2 needs the input of the probe: write `gcode: {probe: CONTROLLER.INPUT}`"),
        ("G41 D1", "G41 is not supported: it offsets the path by the radius"),
        ("G1 F60 X1\nG54.5", "2: column 1: G54.5 is not supported"),
        ("G0 X1\nM7", "2: column 1: M7 needs `gcode: {coolant: none}`"),
        ("T1 M6", "column 1: T needs `gcode: {tools: none}`"),
        ("G43 H1 Z1", "G43 needs `gcode: {tools: none}`"),
        ("T1.5 M6", "column 1: T is a number of a tool, from 0, not 1.5"),
        ("G93 F1 G81 X1 Z-1 R1", "G81 has no time of its own"),
        ("O0001", "alone it is of fanuc"),
        ("M0", "M0 waits for a person: write `gcode: {pause:"),
        ("/G0 X1", "column 1: a line that begins with / runs or not"),
        ("G55 G0 X1", "where G55 is, is not known: write `gcode: {offsets: {G55: [0, 0, 0]}}`"),
        ("G28", "where G28 goes is not known"),
        ("G10 L1 P1 Z1", "G10 L1 is not supported"),
        ("G10 L2 P1 X1 R5", "R5 has no meaning"),
        ("G20 A1", "no axis is named for A"),
        ("G0 X1 (open", "column 7: '(open' is no word"),
        ("N1 G0 X1*7", "column 9: the checksum of the line is"),
        ("F60 G1 X1 E2", "E2 has no meaning"),
    ],
)
def test_what_is_refused_with_its_place(text: str, words: str) -> None:
    assert words in refuse(text)


def test_the_turns_of_an_arc() -> None:
    (step,) = read("G0 X10\nF600 G2 X10 Y0 I-5 J0 P3\nG3 X0 I-5 P2").steps
    _, circle, arc = step["pieces"]
    assert (circle["piece"], circle["turns"], arc["piece"], arc["turns"]) == ("helix", 2, "helix", 1)


# Probing

TOUCH = {"probe": "gantry.touch"}


@pytest.mark.parametrize(
    ("code", "level", "otherwise"),
    [
        ("G38.2", "active", "fail"),
        ("G38.3", "active", "continue"),
        ("G38.4", "passive", "fail"),
        ("G38.5", "passive", "continue"),
    ],
)
def test_each_code_of_probing_is_a_step(code: str, level: str, otherwise: str) -> None:
    probe, *back, move = read(f"G20\n{code} Z-0.1 F6\nG0 Z1", **TOUCH).steps
    assert probe == {
        "do": "probe",
        "name": "line 2",
        "to": {"gantry.z": "-2.54 mm"},
        "until": "gantry.touch",
        "by": "controller",
        "level": level,
        "speed": "2.54 mm/s",
        "else": otherwise,
        "start": dict.fromkeys(AXES.values(), "0 mm"),
    }
    # A program that goes on anyway does not know whether there is a contact to go back to.
    assert [step["to"]["gantry.z"]["of"] for step in back] == ["line 2.gantry.z"] * (otherwise == "fail")
    assert move["do"] == "move" and move["to"] == {"gantry.z": "25.4 mm"}


@pytest.mark.parametrize(
    ("text", "to", "by"),
    [
        ("G91 G0 Z2", {"gantry.z": {"of": "line 1.gantry.z", "plus": "2 mm"}}, {}),
        ("G0 X3", {"gantry.x": "3 mm"}, {}),
        ("G91 G1 X3 Z1", {"gantry.x": "3 mm", "gantry.z": {"of": "line 1.gantry.z", "plus": "1 mm"}}, {}),
        ("G0 Z-5", {"gantry.z": "-5 mm"}, {}),
        ("G53 G0 Z2", {"gantry.z": "2 mm"}, {}),
        ("G38.3 Z-9\nG91 G0 X1 Z2", {"gantry.x": "1 mm"}, {"gantry.z": "2 mm"}),
    ],
)
def test_what_follows_a_probe_is_a_move_from_rest(text: str, to: dict[str, Any], by: dict[str, Any]) -> None:
    (*_, move) = read(f"G38.2 Z-5 F60\n{text}", **TOUCH).steps
    assert move["do"] == "move" and move.get("to", {}) == to and move.get("by", {}) == by and move["sync"] == "phase"


def test_a_probe_of_several_axes_is_a_line() -> None:
    probe, back, zero, move = read("G38.2 X3 Z-4 F60\nG92 X0\nG91 G0 Z1", **TOUCH).steps
    assert probe["to"] == {"gantry.x": "3 mm", "gantry.z": "-4 mm"} and probe["speed"] == "1 mm/s"
    contacts = {axis: {"of": f"line 1.{axis}"} for axis in ("gantry.x", "gantry.z")}
    assert back["to"] == contacts and back["sync"] == "phase" and zero["do"] == "set-position"
    assert move["to"] == {"gantry.z": {"of": "line 1.gantry.z", "plus": "1 mm"}}
    with pytest.raises(FileError, match=r"G38\.2 moves X and Z, and a computer stops one axis at a time"):
        read("G38.2 X3 Z-4 F60", probe={"input": "gantry.touch", "by": "host"})


def test_a_probe_is_a_motion_that_holds() -> None:
    steps = read("G91 G38.2 Z-5 F60\nG0 Z1\nG38.2 Z-2 F30\nZ-1", **TOUCH, dialect="grbl").steps
    assert [step["do"] for step in steps] == ["probe", "move", "move", "probe", "move", "probe", "move"]
    assert steps[3]["to"] == {"gantry.z": {"of": "line 1.gantry.z", "plus": "-1 mm"}}
    assert steps[5]["to"] == {"gantry.z": {"of": "line 3.gantry.z", "plus": "-1 mm"}}


@pytest.mark.parametrize("zero", ["G92 Z0.5 X7", "G10 L20 P0 X7 Z0.5", "G10 L20 P1 X7 Z0.5"])
def test_a_zero_at_a_contact_is_a_user_position(zero: str) -> None:
    contents = read(f"G54\nG38.2 Z-5 F60\n{zero}\nG0 X8\nZ2", **TOUCH, offsets={"G54": [0, 0, 10]})
    *_, zeroing, path = contents.steps
    assert zeroing == {"do": "set-position", "axes": {"gantry.z": "10.5 mm"}}
    # X is where it was, and has another number.
    assert path["start"] == ["0 mm", "0 mm", "10.5 mm"]
    assert [piece["to"] for piece in path["pieces"]] == [["1 mm", "0 mm", "10.5 mm"], ["1 mm", "0 mm", "12 mm"]]
    assert "line 3 sets the user position of gantry.z, which stays behind the program" in contents.notes


def test_a_program_has_a_contact_or_ends() -> None:
    assert read("G38.2 Z-5 F60\no1 if [#5070 EQ 1]\nG0 X5\no1 endif", **TOUCH).steps[-1]["to"] == {"gantry.x": "5 mm"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("G38.2 Z0 F60", "column 1: G38.2 moves no axis"),
        ("G38.2 F60", "column 1: G38.2 moves no axis"),
        ("G38.2 Z-1", "no feed is chosen"),
        ("G38.6 Z-1 F60", "G38.6 is not supported"),
        ("G38 Z-1 F60", "G38 is not supported: it is G38.2 to G38.5"),
        ("G53 G38.2 Z-1 F60", "G53 needs G0 or G1"),
        ("G38.2 Z-1 F60\nG2 X2 I1", "2: G2 needs to know where Z stands, which line 1 measures"),
        ("G38.2 Z-1 F60\nG81 X2 Z-1 R1", "2: G81 needs to know where Z stands"),
        ("G38.2 Z-1 F60\n#1=#5063", "2: #5063 is measured when the program runs"),
        ("G38.3 Z-1 F60\n#1=#5070", "2: #5070 is measured when the program runs"),
        ("G38.2 Z-1 F60\n#1=#<_z>", "2: a parameter needs to know where Z stands"),
        ("#1=#5063\nG38.2 Z-1 F60", "1: column 4: parameter #5063 has no value here"),
        ("G38.3 Z-1 F60\nG91 G38.2 Z-1", "2: G38.2 would end so far from where Z stands, which is not known"),
        ("G38.2 Z-1 F60\nG10 L20 P2 Z0", "2: the zero of Z at a contact is that of G54, which is chosen"),
        ("G38.2 Z-1 F60\nG92 Z0\nG53 G0 Z1", "3: line 2 has set the zero of Z at a contact, and G53 counts from"),
        ("G38.2 Z-1 F60\nG92 Z0\nG28", "3: line 2 has set the zero of Z at a contact, and G28 counts from"),
        ("G38.2 Z-1 F60\nG92 Z0\nG92.1", "3: line 2 has set the zero of Z at a contact, and G92.1 counts from"),
        ("G38.2 Z-1 F60\nG92 Z0\nG10 L2 P1 Z1", "3: line 2 has set the zero of Z at a contact, and G10 L2 counts"),
        ("G38.2 Z-1 F60\nG10 L20 P1 Z0\nG55", "3: line 2 has set the zero of Z in G54 at a contact"),
    ],
)
def test_what_a_probe_leaves_unknown_is_refused_with_its_line(text: str, words: str) -> None:
    assert words in refuse(text, **TOUCH, offsets=HOME | {"G55": [0, 0, 0]})


def test_fanuc_has_no_such_code() -> None:
    assert "G38.2 is no code of fanuc" in refuse("G38.2 Z-1. F60", **TOUCH, dialect="fanuc")


def test_a_program_begins_behind_a_zero_and_not_beside_a_contact() -> None:
    text = "G38.2 Z-1 F60\nG0 X1\nG92 Z0\nG0 X5\nX6"
    with pytest.raises(FileError, match="to begin here needs to know where Z stands, which line 1 measures"):
        read(text, 2, **TOUCH)
    contents = read(text, 5, **TOUCH)
    assert contents.steps[0] == {"do": "move", "to": {"gantry.x": "5 mm", "gantry.y": "0 mm", "gantry.z": "0 mm"}}
    assert contents.modes[-1] == "zero of Z as line 3 has set it at a contact"


def test_a_dwell_with_words_of_axes_is_a_dwell_and_a_motion() -> None:
    steps = read("G91\nF600 G1 X10\nG4 P0.5 X5\nG1 X10").steps
    assert [step["do"] for step in steps] == ["path", "dwell", "path"]
    assert points("G91\nF600 G1 X10\nG4 P0.5 X5\nG1 X10")[-1] == (25, 0, 0)


@pytest.mark.parametrize("end", ["%", "M2", "M30", " m30 (end)"])
def test_what_stands_behind_the_end_is_not_read(end: str) -> None:
    assert points(f"%\nG0 X1\n{end}\nG0 X9 nonsense\n") == [(1, 0, 0)]


@pytest.mark.parametrize("off", ["X10.001 Y0", "X9.999 Y0", "X10.004 Y0"])
def test_a_circle_whose_end_is_off_by_rounding_is_a_circle(off: str) -> None:
    (step,) = read(f"G0 X10\nF600 G2 {off} I-5 J0\nG1 X20").steps
    circle = step["pieces"][1]
    assert circle["piece"] == "helix" and circle["to"] == ["10 mm", "0 mm", "0 mm"]


def test_a_circle_or_a_very_short_arc_is_refused() -> None:
    assert "1: the end of the arc is 0.001 mm from its start" in refuse("F600 G2 X0 Y0.001 I5 J0")
    # Backwards it is a circle but for 0.001 mm, and far enough forwards an arc.
    assert points("F600 G2 X0 Y-0.001 I5 J0") == [(0, -0.001, 0)]
    assert points("F600 G2 X0 Y0.1 I5 J0.01")


def test_equal_points_are_skipped_however_they_are_written() -> None:
    text = "G91 F60 G1 X0.1\n" + "X0.1\n" * 2 + "X-0.3\nG90 X0\nX0.00000000000001\nX1"
    assert points(text)[-2:] == [(0, 0, 0), (1, 0, 0)]


def test_what_is_skipped_is_said() -> None:
    text = add_checksum("N1 G40 G49 G80 G94 M9") + "\nG0 X1 M3 S100\nM30"
    assert read(text, spindle="none").notes == [
        "skipped, changes no path and no tool: *, G40, G94, M9, G49, G80, M30",
        "skipped by `gcode:`: S, M3",
    ]


SPINDLE = {"forward": "r.spindle", "reverse": "r.back", "speed": 9000, "wait": "2 s"}


def outline(text: str, **settings: Any) -> list[str]:
    """The steps in short words."""
    lines: list[str] = []
    for step in read(text, **settings).steps:
        if step["do"] == "output":
            lines.append(f"{step['output']} {'on' if step['value'] else 'off'}")
        else:
            lines.append(str({"dwell": step.get("duration"), "wait": step.get("input")}.get(step["do"], step["do"])))
    return lines


def test_outputs_stand_for_spindle_and_coolant() -> None:
    text = "S9000 M3\nG0 X1\nM8\nF60 G1 X2\nM3\nM4 X3\nM9 M5\nX4\nM7\nX5\nM30"
    coolant = {"mist": "r.mist", "flood": "r.flood"}
    assert outline(text, spindle=SPINDLE, coolant=coolant) == [
        *("r.spindle on", "2 s", "path", "r.flood on", "path"),  # M3 again changes nothing
        *("r.spindle off", "2 s", "r.back on", "2 s", "path", "r.back off", "2 s", "r.flood off", "path"),
        *("r.mist on", "path", "r.mist off"),  # the end of the program
    ]
    assert read(text, spindle=SPINDLE, coolant=coolant).notes[-1] == (
        "switched, or waited for, by `gcode:`: M3 (2), M8, M4, M5, M9, M7"
    )
    assert outline("M3\nF60 G1 X1", spindle={"forward": "r.spindle"}) == ["r.spindle on", "path", "r.spindle off"]


def test_a_person_changes_tools_with_the_spindle_at_rest() -> None:
    tools = {"change": {"input": "r.go", "timeout": "10 min"}}
    text = "M3\nF60 G1 X1\nT2 M6\nM3\nX2"
    assert outline(text, spindle=SPINDLE, tools=tools) == [
        *("r.spindle on", "2 s", "path", "r.spindle off", "2 s", "r.go", "r.spindle on", "2 s", "path"),
        *("r.spindle off", "2 s"),
    ]
    assert "2: column 1: G43 needs lengths" in refuse("T1 M6\nG43 H1\nG0 X1", spindle="none", tools=tools)


def test_a_part_of_a_program_begins_with_its_outputs_on() -> None:
    steps = read("S9000 M3 M8\nF60 G1 X1\nX2\nX3", 3, spindle=SPINDLE, coolant={"flood": "r.flood"}).steps
    assert [(step["do"], step.get("output")) for step in steps] == [
        *(("output", "r.spindle"), ("output", "r.flood"), ("dwell", None), ("move", None), ("path", None)),
        *(("output", "r.spindle"), ("output", "r.flood"), ("dwell", None)),
    ]


@pytest.mark.parametrize(
    ("text", "settings", "words"),
    [
        ("G0 X1 M4", {"spindle": {"forward": "r.s"}}, "column 7: M4 needs `gcode: {spindle: {reverse:"),
        ("G0 X1 S100", {"spindle": SPINDLE}, "column 7: S100: the spindle is switched on and off, and runs at 9000"),
        ("G0 X1 M7", {"coolant": {"flood": "r.f"}}, "column 7: M7 needs `gcode: {coolant: {mist:"),
        ("G0 X1 M8", {"coolant": {}}, "column 7: M8 needs `gcode: {coolant: {flood:"),
    ],
)
def test_what_no_output_stands_for_is_refused(text: str, settings: dict[str, Any], words: str) -> None:
    assert words in refuse(text, **settings)


# Modes


def test_feeds() -> None:
    (step,) = read("G93 F2 G1 X10\nF1 X30\nG94 F60 X31\nG95 S100 F0.5 X32", spindle="none").steps
    speeds = [float(piece["speed"].removesuffix(" mm/s")) for piece in step["pieces"]]
    assert speeds == pytest.approx([10 * 2 / 60, 20 / 60, 1, 50 / 60])


def test_the_inverse_time_of_a_helix_is_that_of_its_length() -> None:
    (step,) = read("G93 F1 G2 X10 Z3 I5").steps
    assert float(step["speed"].removesuffix(" mm/s")) == pytest.approx(hypot(3.141592654 * 5, 3) / 60)


def test_absolute_centres_and_planes() -> None:
    (step,) = read("G54 G10 L2 P1 X1\nG0 X0 Y0\nF60 G90.1 G2 X10 Y0 I5 J0\nG91.1 G2 X0 I-5").steps
    assert [piece.get("centre") for piece in step["pieces"]][-2:] == [["6 mm", "0 mm"], ["6 mm", "0 mm"]]


def test_the_job_chooses_corners_that_the_program_does_not() -> None:
    (step,) = read("G0 X1\nF60 G1 X2\nG61.1 X3\nG64 P0.1 Q0.1 X4").steps
    assert [piece.get("corner") for piece in step["pieces"]] == ["stop", None, "stop", {"within": "0.1 mm"}]
    (step,) = read("G61 G0 X1\nF60 G1 X2\nG64 X3").steps
    assert [piece.get("corner") for piece in step["pieces"]] == ["stop", "stop", None]
    assert "G64 needs a tolerance above 0" in refuse("G64 Q0.1\nG0 X1")


# Offsets


def test_work_offsets() -> None:
    offsets = {"offsets": {"G55": [10, "2 cm", 0]}}
    assert points("G55 G0 X1 Y1 Z1\nG53 G0 Z5\nG54 X1", **offsets) == [(11, 21, 1), (11, 21, 5), (1, 21, 5)]
    assert points("G10 L2 P2 X1 Y2 Z3\nG55 G0 X1") == [(2, 0, 0)]
    assert "where G55 is" in refuse("G10 L2 P2 X1\nG55 G0 X1")
    assert points("G0 X5\nG10 L20 P0 X0\nG0 X1") == [(5, 0, 0), (6, 0, 0)]


def test_shifts() -> None:
    assert points("G0 X5\nG92 X0\nG0 X1\nG92.2 G0 X2\nG92.3 G0 X3\nG92.1 X1") == [
        *((5, 0, 0), (6, 0, 0)),
        *((2, 0, 0), (8, 0, 0), (1, 0, 0)),
    ]
    assert points("G52 X3\nG0 X1\nG52 X0\nG0 X1") == [(4, 0, 0), (1, 0, 0)]
    assert points("G0 X5\nG92 X1\nG92 X2\nG0 X3") == [(5, 0, 0), (6, 0, 0)]


def test_lengths_of_tools(tmp_path: Path) -> None:
    (tmp_path / "a.tbl").write_text("T1 P1 Z10.5 D6 ; end mill\nT2 P2 Z-3\n")
    settings = GcodeSettings(tools="a.tbl")
    text = "T1 M6 G43\nG0 Z1\nG43 H2 Z1\nG43.1 Z2\nZ1\nG49 Z1"
    steps = GcodeReader("a.ngc", AXES, None, settings, tmp_path).read_steps(text.split("\n"))
    assert [piece["to"][2] for piece in steps[0]["pieces"]] == ["11.5 mm", "-2 mm", "3 mm", "1 mm"]
    for line in ("G43 H9", "T9 M6"):
        with pytest.raises(FileError, match="the tool table has no tool 9"):
            GcodeReader("a.ngc", AXES, None, settings, tmp_path).read_steps([line])
    with pytest.raises(FileError, match="tool table cannot be read"):
        GcodeReader("a.ngc", AXES, None, GcodeSettings(tools="b.tbl"), tmp_path)


def test_home() -> None:
    assert points("G0 X5 Z1\nG91 G28 Z0\nG90 X6", offsets=HOME) == [(5, 0, 1), (5, 0, 50), (6, 0, 50)]
    assert points("G0 X5 Z1\nG28 Z10", offsets=HOME) == [(5, 0, 1), (5, 0, 10), (5, 0, 50)]
    assert points("G0 X5 Z1\nG30", offsets=HOME)[-1] == (0, 0, 60)


# Cycles


def test_drilling() -> None:
    holes = points("G0 Z10\nG98 G81 X1 Y1 Z-2 R1 F60\nG99 X2\nG80 G0 Z20")
    assert holes == [
        (0, 0, 10),
        *((1, 1, 10), (1, 1, 1), (1, 1, -2), (1, 1, 10)),
        *((2, 1, 10), (2, 1, 1), (2, 1, -2), (2, 1, 1)),
        (2, 1, 20),
    ]


def test_pecking_dwelling_and_repeating() -> None:
    assert [z for *_, z in points("G0 Z5\nG83 X1 Z-3 R1 Q2 F60")] == [5, 5, 1, -1, 1, -0.746, -3, 5]
    assert [z for *_, z in points("G0 Z5\nG73 X1 Z-3 R1 Q2 F60")] == [5, 5, 1, -1, -0.746, -3, 5]
    assert [step["do"] for step in read("G0 Z5\nG82 X1 Z-3 R1 P0.5 F60").steps] == ["path", "dwell", "path"]
    assert [x for x, *_ in points("G0 Z5\nG91 G81 X2 Z-3 R-4 L3 F60")][1::4] == [2, 4, 6]
    assert [z for *_, z in points("G85 X1 Z-3 R1 F60")] == [1, 1, -3, 1]
    for text, words in (("G81 X1 R1 F60", "G81 needs Z"), ("G81 X1 Z-1 F60", "needs R"), ("G83 X1 Z-1 R1", "needs Q")):
        assert words in refuse(text)
    assert "R of G81 is below" in refuse("G81 X1 Z3 R1 F60")
    assert "more than 10000 pecks" in refuse("G83 X1 Z-3 R1 Q0.00001 F60")


# Pauses, parts of a program, dialects


def test_pauses() -> None:
    assert [step["do"] for step in read("G0 X1\nM0\nG0 X2", pause={"input": "gantry.go"}).steps] == [
        "path",
        "wait",
        "path",
    ]
    assert len(read("G0 X1\nM1\nG0 X2", pause="none").steps) == 1
    assert len(points("/G0 X1\nG0 X2", block_delete="run")) == 2
    assert len(points("/G0 X1\nG0 X2", block_delete="skip")) == 1


def test_a_part_of_a_program() -> None:
    imported = read("G20 G91 G18 T3 M6\nG55\nF10 G1 X1\nX1\nX2", 5, offsets={"G55": [1, 0, 0]}, tools="none")
    move, path = imported.steps
    assert move == {"do": "move", "to": {"gantry.x": "50.8 mm", "gantry.y": "0 mm", "gantry.z": "0 mm"}}
    assert path["start"][0] == "50.8 mm" and path["pieces"][0]["to"][0] == "101.6 mm"
    assert imported.modes == [
        *("work offset G55", "tool 3", "spindle off", "feed 254 mm/min", "plane G18", "units inch (G20)"),
        *("increments (G91)", "motion G1"),
    ]
    assert "spindle M3 S5000" in read("S5000 M3\nG0 X1\nG0 X2", 3, spindle="none").modes
    with pytest.raises(FileError, match="5: the program ends at line 2, before it"):
        read("G0 X1\nM2\n", 5)


def test_dialects() -> None:
    assert read("F60 G1 X1\nG4 P500\nG0 X2", dialect="marlin").steps[1]["duration"] == "0.5 s"
    assert read("F60 G1 X1\nG4 S2\nG0 X2", dialect="marlin").steps[2]["speed"] == "1 mm/s"
    assert read("G0 X1.\nG4 X0.5", dialect="fanuc").steps[1]["duration"] == "0.5 s"
    assert "X10 has no decimal point" in refuse("G0 X10", dialect="fanuc")
    assert "G64 is no code of grbl" in refuse("G64 P0.1", dialect="grbl")
    assert "is no word" in refuse("#1=2", dialect="grbl")
    assert "E1 has no meaning" in refuse("F60 G1 X1 E1", dialect="marlin")
    assert "G29 is not supported: it measures a bed" in refuse("G29", dialect="marlin")


# Parameters and O words


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("[1 + 2 * 3 ** 2]", 19),
        ("[2 ** 3 ** 2]", 64),
        ("[10 - 4 - 3]", 3),
        ("[7 MOD 4 + -7 MOD 4]", 4),
        ("[1 LT 2 AND 2 GT 1]", 1),
        ("[1 EQ 1.00001 XOR 0]", 1),
        ("SIN[30]", 0.5),
        ("ATAN[1]/[-1]", 135),
        ("ROUND[-2.5]", -3),
        ("FIX[-2.5]", -3),
        ("FUP[2.1]", 3),
        ("SQRT[ABS[-16]]", 4),
        ("-[1+1]", -2),
        ("-#1", -7),
        ("##2", 7),
        ("#[#2 + 1]", 1),
        ("#<_metric>", 1),
        ("EXISTS[#<nothing>]", 0),
        ("EXISTS[#<a name>]", 1),
        ("#5420", 3),
    ],
)
def test_expressions(expression: str, value: float) -> None:
    text = f"G0 X3\n#1=7 #2=1\n#<a name>=4\nG0 Y100\nG0 Y{expression}"
    assert points(text)[-1][1] == pytest.approx(value)


def test_a_parameter_is_set_behind_the_words_of_its_line() -> None:
    assert points("#3=15\n#3=6 G0 X#3\nX#3") == [(15, 0, 0), (6, 0, 0)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("G0 X[1/0]", "column 7: the expression cannot be computed: a division by 0"),
        ("G0 X[-8 ** 0.5]", "does not exist"),
        ("G0 X SQRT[-1] Y[1]", "the expression cannot be computed"),
        ("G0 X[10 ** 300 ** 2]", "it is too large"),
        ("G0 X#<none>", "parameter #<none> has no value here"),
        ("G0 X#5161", "parameter #5161 has no value here"),
        ("#5401=1", "column 1: parameter 5401 is the machine's"),
        ("G0 X#0", "a parameter has a number from 1 to 5602, not 0"),
        ("G0 X[1 +", "the line ends where a number is expected"),
        ("G0 X[1 2]", "column 8: '2]' stands where an operator or ] is expected"),
        ("G0 X" + "[" * 60 + "1", "brackets are nested more than 50 deep"),
        ("G0 X" + "#" * 60 + "1", "nested more than 50 deep"),
        ("o1 sub\nG0 X1", "1: column 1: o1 sub has no o1 endsub"),
        ("o1 endif", "o1 endif has no o1 if before it"),
        ("o1 break", "stands outside of a loop"),
        ("o1 return", "stands outside of a subroutine"),
        ("o1 dance", "o1 dance: an O word is followed by one of"),
        ("o5 call", "o5 is no subroutine of this file"),
        ("o1 sub\no1 call\no1 endsub\no1 call", "2: column 1: subroutines call each other more than 10 deep"),
        ("o1 sub\no1 endsub\no1 sub\no1 endsub", "o1 sub is there twice"),
    ],
)
def test_wrong_expressions_and_o_words(text: str, words: str) -> None:
    assert words in refuse(text)


def test_branches_and_loops() -> None:
    text = """#1 = 0
o1 do
  #1 = [#1 + 1]
  o2 if [#1 EQ 2]
    o1 continue
  o2 elseif [#1 EQ 3]
    G0 X3
  o2 elseif [#1 EQ 4]
    G0 X4
  o2 else
    G0 X9
  o2 endif
o1 while [#1 LT 5]
o3 while [1]
  G0 X[#1 + 10]
  o3 break
o3 endwhile
o<f> sub
  o<f> return [#1 * 2]
o<f> endsub
o<f> call [21]
G0 X#<_value>
"""
    assert [x for x, *_ in points(text)] == [9, 3, 4, 9, 15, 42]


def test_a_loop_that_does_not_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flow, "MOST_LINES", 5_000)
    for text in ("o1 while [1]\no1 endwhile", "o1 while [1]\nG91 G0 X1\no1 endwhile", "o1 do\nG4 P0\no1 while [1]"):
        assert "more than 5000 lines have run" in refuse(text)


# Styles and mutations


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("seed", range(3))
def test_styles_of_ten_programs_are_read(style: str, seed: int) -> None:
    make, dialect = STYLES[style]
    imported = read(make(random.Random(seed)), **ALL, dialect=dialect, offsets=HOME)
    steps = [{**step, "tolerance": "1 mm"} if step["do"] == "path" else step for step in imported.steps]
    Job.model_validate(make_job("part", steps))
    assert sum(len(places) for places in imported.places) >= 6


WORDS = ("has no meaning", "stands twice", "modal group", "is not supported", "is no word", "would be of", "on and off")


def run_mutation(seed: int) -> None:
    draw = random.Random(seed)
    style = draw.choice(list(STYLES))
    make, dialect = STYLES[style]
    text = mutate(make(draw), draw)
    problems: list[tuple[int, str]] = []
    try:
        imported = read(text, **ALL, dialect=dialect, offsets=HOME)
        if any(step["do"] == "probe" for step in imported.steps):
            steps = [{**step, "tolerance": "1 mm"} if step["do"] == "path" else step for step in imported.steps]
            Job.model_validate(make_job("part", steps))
    except FileError as error:
        problems = [(problem.line, problem.text) for problem in error.problems]
    if dialect != "linuxcnc" or style == "linuxcnc" or any(sign in text for sign in "#[*oO\0"):
        return
    wrong = WordReader().find_first(text)
    first, words = problems[0] if problems else (10**9, "")
    assert wrong is None or first <= wrong, (seed, wrong, text)
    if any(part in words for part in WORDS):
        assert first == wrong, (seed, first, words, text)


def test_mutated_programs_are_read_or_refused_and_no_word_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flow, "MOST_LINES", 20_000)
    for seed in range(300):
        run_mutation(seed)


@pytest.mark.nightly
def test_many_mutated_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flow, "MOST_LINES", 20_000)
    for seed in range(300, 5_300):
        run_mutation(seed)


# Hostile files


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"G0 X1\n(\xb5m)\n", "2: byte 0xb5 is not UTF-8 text; save the file as UTF-8 (in Windows-1252, 0xb5 is"),
        ("G0 X1\n".encode("utf-16"), "is UTF-16 text; save it as UTF-8"),
        (b"G0 X1\nG\0 X2\n", "2: has a character of number 0"),
        (b"G0 X" + b"9" * 400, "beyond 1e+09"),
        (b"G0 X1" + b" " * 20_000, "the maximum is 10000"),
    ],
)
def test_hostile_bytes(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "a.ngc").write_bytes(data)
    with pytest.raises(FileError) as caught:
        read_path_file(tmp_path / "a.ngc", AXES, GcodeStart())
    assert words in str(caught.value)


def test_reading_costs_less_than_100_us_a_line() -> None:
    lines = [f"N{k} G{1 + k % 2} X{k % 97}.5 Y{k % 89}" + (" R500." if k % 2 else "") for k in range(5_000)]
    costs_s: list[float] = []
    gc.freeze()  # the collector does not look at what other tests have left
    try:
        for _ in range(3):
            begun_s = time.process_time()
            GcodeReader("a.ngc", AXES).read_steps(["F600 G64 P0.01", *lines])
            costs_s.append(time.process_time() - begun_s)
    finally:
        gc.unfreeze()
    assert min(costs_s) / 5_000 < 100e-6


def test_the_page_of_codes_names_all_of_them() -> None:
    page = (ROOT / "docs" / "reference" / "g-code.md").read_text(encoding="utf-8")
    missing = [code.name for code in CODES.values() if f"{code.name}" not in page]
    assert not missing
