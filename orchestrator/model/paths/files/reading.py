"""Files of paths by their kind: `.ngc`, `.csv`, `.yaml`."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from orchestrator.model.files.yaml_reader import YamlError, decode_text
from orchestrator.model.jobs.files import FileError, FileProblem, read_file
from orchestrator.model.paths.files.base.imported import ImportedSteps
from orchestrator.model.paths.files.columns import ColumnReader
from orchestrator.model.paths.files.gcode.reader import GcodeReader
from orchestrator.model.paths.files.trajectory import TrajectoryReader
from orchestrator.model.paths.gcode_settings import GcodeSettings
from orchestrator.model.paths.source import digest_text

GCODE = (".ngc", ".gcode", ".nc", ".tap")
TABLES = (".csv",)
TRAJECTORIES = (".yaml", ".yml", ".json")
MAX_FILE_BYTES = 64_000_000
_LINE_END = re.compile(r"\r\n?|\n")


@dataclass(frozen=True, slots=True)
class GcodeStart:
    """How a program in G-code begins. places: where the axes stand, mm, by letter; settings: what stands for its
    machine; from_line: the line with which its steps begin; folder: of the tool table."""

    places: Mapping[str, float] = field(default_factory=dict[str, float])
    settings: GcodeSettings | None = None
    from_line: int = 1
    folder: Path | None = None


def read_path_file(path: Path, axes: Mapping[str, str], begin: GcodeStart) -> ImportedSteps:
    """The steps that a file of another program stands for. axes: by its own names, the axes of the fleet. begin: of
    G-code.

    Raises `FileError` with every mistake; then nothing is imported.
    """
    kind, name = path.suffix.lower(), str(path)
    if kind not in GCODE and (begin.settings is not None or begin.from_line > 1):
        raise FileError([FileProblem(name, 1, "", "is no G-code: `gcode:` and --from-line have no meaning")])
    if kind in TRAJECTORIES:
        steps = TrajectoryReader(read_file(path), axes).read_steps()
        return ImportedSteps(name, steps, [[] for _ in steps], digests=digest_files([path.name], path.parent))
    if kind not in GCODE + TABLES:
        known_kinds = ", ".join(GCODE + TABLES + TRAJECTORIES)
        raise FileError([FileProblem(name, 1, "", f"is of no known kind; its name must end in one of: {known_kinds}")])
    text = read_path_text(path)
    digests = {path.name: digest_text(text)}
    lines = _LINE_END.split(text.removesuffix("\n").removesuffix("\r"))
    if kind in TABLES:
        return replace(ColumnReader(name, axes).read_all(lines), digests=digests)
    contents = GcodeReader(name, axes, begin.places, begin.settings, begin.folder).read_all(lines, begin.from_line)
    table = None if begin.settings is None else begin.settings.tool_table
    return replace(contents, digests=digests | digest_files([table] if table else [], begin.folder or Path()))


def digest_files(names: Iterable[str], folder: Path) -> dict[str, str]:
    """By name, what tells the text of each file from another one. Raises `FileError`."""
    return {name: digest_text(read_path_text(folder / name)) for name in names}


def read_path_text(path: Path) -> str:
    """The text of a file of a path. Raises `FileError`."""
    name = str(path)
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise FileError([FileProblem(name, 1, "", f"cannot be read: {error.strerror}")]) from None
    if len(data) > MAX_FILE_BYTES:
        text = f"has more than {MAX_FILE_BYTES // 1_000_000} MB; split the program"
        raise FileError([FileProblem(name, 1, "", text)])
    try:
        text = decode_text(data, MAX_FILE_BYTES)
    except YamlError as error:
        raise FileError(FileProblem(name, problem.line, "", problem.text) for problem in error.problems) from None
    if (at := text.find("\0")) >= 0:
        line = text.count("\n", 0, at) + 1
        raise FileError([FileProblem(name, line, "", "has a character of number 0; save the file as UTF-8 text")])
    return text
