"""What is chosen for a program, as texts: the fields of a form, and what its job keeps, so that it can be continued."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, FileProblem, validate_part
from orchestrator.model.paths.gcode_settings import GcodeSettings
from orchestrator.model.paths.source import digest_text
from orchestrator.model.units import Unit, find_dimension

PROGRAM, DIGEST, START, FROM_LINE = "program", "program digest", "start", "from line"
CORNER, TOLERANCE, ZEROS = "corner", "tolerance", "zeros of axes"
FORM = "the form"
UNSET = "not chosen"
LETTERS = "XYZABCUVW"
MOST_TEXT = 120  # characters of a value that a job keeps
_COMMENT = re.compile(r"\([^)\n]*\)|;.*")
_WORDS: Mapping[str, tuple[str, str]] = {
    "spindle": (r"(?<![A-Z])(M0*[345](?!\d)|S[\d.])", "a person sees to the spindle, or there is none"),
    "tools": (r"(?<![A-Z])(T\d|M0*6(?!\d)|G43)", "a person sees to the tool, or there is one only"),
    "coolant": (r"(?<![A-Z])M0*[78](?!\d)", "a person sees to the coolant, or there is none"),
    "pause": (r"(?<![A-Z])M(0*[01]|60)(?!\d)", "M0 and M1 do not wait"),
    "block_delete": (r"^\s*/", "lines that begin with /"),
}
_PROBE = re.compile(r"(?<![A-Z])G38\.[2-5]")
_SYSTEM = re.compile(r"(?<![A-Z])G(5[5-9](?:\.[123])?|28|30)(?![.\d])")
_DIALECTS = ("linuxcnc", "grbl", "marlin", "fanuc")


@dataclass(frozen=True, slots=True)
class ProgramText:
    """A program as it came. name: of its file."""

    name: str
    text: str

    @property
    def lines(self) -> list[str]:
        """Its lines, the first one has number 1."""
        return re.split(r"\r\n?|\n", self.text.removesuffix("\n").removesuffix("\r"))

    @property
    def digest(self) -> str:
        """What tells it from another text."""
        return digest_text(self.text)

    @property
    def code(self) -> str:
        """Its words in capitals, without comments."""
        return _COMMENT.sub(" ", self.text).upper()


@dataclass(frozen=True, slots=True)
class ProgramSettings:
    """What is chosen, checked. axes: by letter; start: mm, by letter. texts: all of it, as the job keeps it."""

    axes: Mapping[str, str]
    start: Mapping[str, float]
    tolerance: str
    corner: str
    gcode: GcodeSettings
    from_line: int
    texts: Mapping[str, str]


def describe_fields(
    program: ProgramText, fleet: Fleet, places: Mapping[str, float], values: Mapping[str, str]
) -> list[dict[str, Any]]:
    """The fields that this program needs, with their defaults. places: where axes stand now, mm. values: what is in
    the form."""
    code, letters = program.code, find_letters(program)
    axes = [name for name in fleet.axis_names if find_dimension(Unit(fleet.axis(name).unit)) == "length"]
    chosen_axes = _choose_axes(letters, axes)
    fields = [
        {"name": letter, "type": "text", "default": chosen_axes.get(letter, UNSET), "choices": [UNSET, *axes]}
        for letter in letters
    ]
    given_axes = {letter: values.get(letter) or chosen_axes.get(letter, UNSET) for letter in letters}
    start = " ".join(f"{letter}{places[axis]:.9g}" for letter, axis in given_axes.items() if axis in places)
    fields += [
        _make_field(FROM_LINE, "1", "the lines before it only set the modes"),
        _make_field(START, start, "where the axes stand before line 1, mm; as a preset where they stand now"),
        _make_field(TOLERANCE, "100 um", "how far the axes may be off the path"),
        _make_field(CORNER, "stop", "where neither G61 nor G64 holds: stop, or a distance such as 50 um"),
        {"name": "dialect", "type": "text", "default": _DIALECTS[0], "choices": list(_DIALECTS)},
    ]
    for name, (pattern, meaning) in _WORDS.items():
        if re.search(pattern, code, re.MULTILINE):
            choices = [UNSET, "skip", "run"] if name == "block_delete" else [UNSET, "none"]
            text = meaning if name == "block_delete" else f"none: {meaning}"
            fields.append({"name": name, "type": "text", "default": UNSET, "choices": choices, "description": text})
    if _PROBE.search(code):
        inputs = fleet.names.inputs
        field = {"name": "probe", "type": "text", "default": UNSET, "choices": [UNSET, *inputs]}
        fields.append({**field, "description": "the input of the probe"})
    return [*fields, *_describe_offsets(letters, code)]


def find_letters(program: ProgramText) -> list[str]:
    """The letters of axes that the program has words of, in their usual order."""
    present_letters = set(re.findall(r"(?<![A-Z])([XYZABCUVW])(?=\s*[-+.\d\[#])", program.code))
    return [letter for letter in LETTERS if letter in present_letters] or ["X"]


def read_settings(
    program: ProgramText, fields: Sequence[Mapping[str, Any]], values: Mapping[str, str], zeros: Mapping[str, float]
) -> ProgramSettings:
    """The settings of a form. zeros: user minus motor position, by axis: a work piece that is touched off anew is
    elsewhere. Raises `FileError` with every mistake."""
    texts = {str(field["name"]): values.get(field["name"]) or field["default"] or UNSET for field in fields}
    mistakes = _list_strange_values(fields, values, texts)
    mistakes += _list_mistakes(texts, letters := find_letters(program))
    start = _read_start(texts[START], letters)
    if start is None:
        mistakes.append((START, f"is {texts[START]!r}; write for example {letters[0]}10"))
    settings, wrong_entries = validate_part(_make_mapping(texts), GcodeSettings)
    mistakes += [(".".join(map(str, problem.place)), problem.text) for problem in wrong_entries]
    if mistakes or settings is None or start is None:
        raise FileError([FileProblem(FORM, 0, name, text) for name, text in mistakes])
    axes = {letter: texts[letter] for letter in letters}
    zero_text = " ".join(f"{letter}{zeros.get(axis, 0.0):.9g}" for letter, axis in axes.items())
    texts[ZEROS] = zero_text
    return ProgramSettings(axes, start, texts[TOLERANCE], texts[CORNER], settings, int(texts[FROM_LINE]), texts)


def _list_strange_values(
    fields: Sequence[Mapping[str, Any]], values: Mapping[str, str], texts: Mapping[str, str]
) -> list[tuple[str, str]]:
    """What is no field, or none of its choices."""
    mistakes = [(name, "is no value of this program") for name in values.keys() - texts.keys()]
    return mistakes + [
        (str(field["name"]), f"is {texts[field['name']][:40]!r}; choose one of: {', '.join(field['choices'])}")
        for field in fields
        if "choices" in field and texts[field["name"]] not in field["choices"]
    ]


def _list_mistakes(texts: Mapping[str, str], letters: Sequence[str]) -> list[tuple[str, str]]:
    """What is wrong with single fields."""
    mistakes = [
        (name, f"has more than {MOST_TEXT} characters") for name, text in texts.items() if len(text) > MOST_TEXT
    ]
    axes = [texts[letter] for letter in letters]
    mistakes += [
        (letter, "has no axis; choose the one that stands for it")
        for letter, axis in zip(letters, axes, strict=True)
        if axis == UNSET
    ]
    if len(set(axes)) < len(axes):
        mistakes.append((" ".join(letters), "name an axis twice; choose different ones"))
    if not re.fullmatch(r"[1-9][0-9]{0,8}", texts[FROM_LINE]):
        mistakes.append((FROM_LINE, f"is {texts[FROM_LINE]!r}; write the number of a line, from 1"))
    return mistakes


def _describe_offsets(letters: Sequence[str], code: str) -> list[dict[str, Any]]:
    """A field for each work offset, and each place that the program goes to."""
    zeros, names = ", ".join("0" for _ in letters), " ".join(letters)
    fields = [_make_field("G54", zeros, f"where its zero is, for {names}, in mm or with units")]
    for system in sorted({f"G{match}" for match in _SYSTEM.findall(code)}):
        text = "where it goes" if system in ("G28", "G30") else "where its zero is"
        fields.append(_make_field(system, None, f"{text}, for {names}"))
    return fields


def _read_start(text: str, letters: Sequence[str]) -> dict[str, float] | None:
    """Where the axes stand, mm, by letter; None: it is no such text."""
    start = dict.fromkeys(letters, 0.0)
    for word in text.upper().split() if text != UNSET else []:
        if word[0] not in letters or re.fullmatch(r"[-+]?[0-9]*\.?[0-9]+(E[-+]?[0-9]{1,2})?", word[1:]) is None:
            return None
        start[word[0]] = float(word[1:])
    return start


def _make_field(name: str, default: str | None, description: str) -> dict[str, Any]:
    return {"name": name, "type": "text", "default": default, "description": description}


def _choose_axes(letters: Sequence[str], axes: Sequence[str]) -> dict[str, str]:
    """By letter, the axis of that name on the controller that has most of them."""
    matching_axes: dict[str, dict[str, str]] = {}
    for axis in axes:
        controller, _, local = axis.partition(".")
        if local.upper() in letters:
            matching_axes.setdefault(controller, {})[local.upper()] = axis
    best_match = max(matching_axes.values(), key=len, default=dict[str, str]())
    return {letter: best_match[letter] for letter in letters if letter in best_match}


def _make_mapping(texts: Mapping[str, str]) -> dict[str, Any]:
    """`gcode:` as a job file gives it."""
    names = [name for name in ("dialect", *_WORDS, "probe") if texts.get(name, UNSET) != UNSET]
    systems = {
        name: [_read_place(part) for part in text.split(",")]
        for name, text in texts.items()
        if re.fullmatch(r"G[0-9.]+", name) and text != UNSET
    }
    return {**{name: texts[name] for name in names}, "offsets": systems}


def _read_place(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text.strip()
