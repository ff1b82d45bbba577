"""Files of paths by their kind: `.ngc`, `.csv`, `.yaml`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orchestrator.model.jobs.files import FileError, FileProblem, read_file
from orchestrator.model.paths.files.columns import ColumnReader
from orchestrator.model.paths.files.gcode import GcodeReader
from orchestrator.model.paths.files.trajectory import TrajectoryReader

GCODE = (".ngc", ".gcode", ".nc", ".tap")
TABLES = (".csv",)
TRAJECTORIES = (".yaml", ".yml", ".json")
MAX_FILE_BYTES = 64_000_000


def read_path_file(path: Path, axes: Mapping[str, str], start: Mapping[str, float]) -> list[dict[str, Any]]:
    """The steps that a file of another program stands for. axes: by its own names, the axes of the fleet. start: where
    the axes of G-code stand, mm, by letter.

    Raises `FileError` with every mistake; then nothing is imported.
    """
    kind, name = path.suffix.lower(), str(path)
    if kind in TRAJECTORIES:
        return TrajectoryReader(read_file(path), axes).read_steps()
    if kind not in GCODE + TABLES:
        known_kinds = ", ".join(GCODE + TABLES + TRAJECTORIES)
        raise FileError([FileProblem(name, 1, "", f"is of no known kind; its name must end in one of: {known_kinds}")])
    lines = _read_lines(path)
    if kind in TABLES:
        return ColumnReader(name, axes).read_steps(lines)
    return GcodeReader(name, axes, start).read_steps(lines)


def _read_lines(path: Path) -> list[str]:
    name = str(path)
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
        text = data.decode("utf-8-sig")
    except OSError as error:
        raise FileError([FileProblem(name, 1, "", f"cannot be read: {error.strerror}")]) from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise FileError([FileProblem(name, line, "", "is no text in UTF-8")]) from None
    if len(data) > MAX_FILE_BYTES:
        text = f"has more than {MAX_FILE_BYTES // 1_000_000} MB; split the program"
        raise FileError([FileProblem(name, 1, "", text)])
    return text.splitlines()
