"""Read fleet and job files: YAML in, models out; every mistake is named with file, line, field, value and remedy."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from orchestrator.model.base import Model
from orchestrator.model.errors import TuttiError
from orchestrator.model.expansion.fragments import expand_fleet
from orchestrator.model.explain import list_problems
from orchestrator.model.files.yaml_reader import YamlError, YamlNode, YamlProblem, read_yaml, read_yaml_file
from orchestrator.model.fleet import WITHOUT_REFERENCES, Controller, Fleet
from orchestrator.model.fleet_names import find_reference_problems
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.table_files import read_tables
from orchestrator.model.problems import Problem
from orchestrator.model.steps.scan import Scan
from orchestrator.model.steps.tree import find_scans

M = TypeVar("M", bound=Model)

FLEET_SCHEMA = "tutti.fleet/"
_SEPARATOR = re.compile(r"[.\[]")
_NUMBER = re.compile(r"[0-9]+")
MAX_PROBLEMS = 50  # that are listed; what follows is usually the same again


@dataclass(frozen=True, slots=True)
class FileProblem:
    """One mistake in a file. line: counts from 1; 0 in what a program has made. field: the path of keys, e.g.
    `steps[2].to`. pattern: the same as its short form has it, `controllers.stage-{n}.link`; empty: it has none."""

    file: str
    line: int
    field: str
    text: str
    pattern: str = ""

    def __str__(self) -> str:
        location = f"{self.file}:{self.line}" if self.line else self.file
        return f"{location}: {self.field}: {self.text}" if self.field else f"{location}: {self.text}"


class FileError(TuttiError, ValueError):
    """A file that cannot be used. The text lists its problems in the order of lines, one per line."""

    def __init__(self, problems: Iterable[FileProblem]) -> None:
        self.problems = _merge_members(dict.fromkeys(sorted(problems, key=lambda problem: problem.line)))
        shown_lines = [str(problem) for problem in self.problems[:MAX_PROBLEMS]]
        if len(self.problems) > MAX_PROBLEMS:
            shown_lines.append(f"… and {len(self.problems) - MAX_PROBLEMS} more")
        super().__init__("\n".join(shown_lines))


def _merge_members(problems: Iterable[FileProblem]) -> tuple[FileProblem, ...]:
    """Each mistake of a short form once, with the number of further entries that have it; numbers in it may differ."""
    alike: dict[tuple[str, int, str, str], list[FileProblem]] = {}
    for problem in problems:
        pattern = problem.pattern or problem.field
        text = _NUMBER.sub("0", problem.text) if problem.pattern else problem.text
        alike.setdefault((problem.file, problem.line, pattern, text), []).append(problem)
    return tuple(
        replace(members[0], text=f"{members[0].text} (the same in {len(members) - 1} more of {members[0].pattern})")
        if len(members) > 1
        else members[0]
        for members in alike.values()
    )


@dataclass(frozen=True, slots=True)
class LoadedFile:
    """A file that was read: its name, and the places of its values. problems: mistakes of the short forms of a fleet
    file."""

    name: str
    root: YamlNode
    problems: tuple[Problem, ...] = ()

    def problem(self, place: Sequence[str | int], text: str) -> FileProblem:
        """A mistake at a place: keys and indices. What is not in the file is reported where it would stand."""
        node, field, pattern = _locate(self.root, place)
        return FileProblem(node.file or self.name, node.line, field, text, pattern)

    def find_folder(self, place: Sequence[str | int]) -> Path:
        """The folder of the file, or of the fragment, that a place is from."""
        return Path(self.find_node(place).file or self.name).parent

    def find_node(self, place: Sequence[str | int]) -> YamlNode:
        """The node at a place, or the last one that leads there."""
        return _locate(self.root, place)[0]


def load_fleet(path: Path | str) -> Fleet:
    """Load the fleet file at `path`. Raises `FileError`."""
    return parse_file(read_file(Path(path)), Fleet)


def locate_point_files(job: Job, folder: Path) -> Job:
    """The job with files of points below `folder`, unless their paths are absolute."""
    scans: dict[int, Scan] = {}
    for scan in find_scans(job.steps):
        if scan.points is not None and scan.points.file is not None:
            table = scan.points.model_copy(update={"file": str(folder / scan.points.file)})
            scans[id(scan)] = scan.model_copy(update={"points": table})
    return job.model_copy(update={"steps": [step.replace_steps(scans) for step in job.steps]}) if scans else job


def read_file(path: Path) -> LoadedFile:
    """Read the YAML file at `path`, in bounded time and memory. Raises `FileError`."""
    try:
        return _load(read_yaml_file(path), str(path), path)
    except YamlError as error:
        raise _make_file_error(error, str(path)) from None


def read_document(text: str, name: str) -> LoadedFile:
    """Read YAML. name: stands for the file in errors. Raises `FileError`."""
    try:
        return _load(read_yaml(text), name, None)
    except YamlError as error:
        raise _make_file_error(error, name) from None


def _load(root: YamlNode, name: str, path: Path | None) -> LoadedFile:
    """A fleet file is expanded here, for all that read one. path: None: it is no file. Raises `YamlError`."""
    schema = root.find_child("schema")
    if schema is None or not schema.text.startswith(FLEET_SCHEMA):
        return LoadedFile(name, root)
    expanded_fleet = expand_fleet(root, path)
    file = LoadedFile(name, expanded_fleet.root, expanded_fleet.problems)
    if expanded_fleet.failures:
        failures = (_locate_problem(problem, name) for problem in expanded_fleet.failures)
        raise FileError([*failures, *(file.problem(problem.place, problem.text) for problem in file.problems)])
    return file


def parse_document(text: str, model: type[M], name: str) -> M:
    """Parse `text` as YAML for `model`. name: stands for the file in errors. Raises `FileError`."""
    return parse_file(read_document(text, name), model)


def parse_file(file: LoadedFile, model: type[M]) -> M:
    """Make a model of what was read. Tables that a fleet file names are read beside it. Raises `FileError` with every
    mistake."""
    require_mapping(file, model)
    fleet_tables = read_tables(file.root.value if model is Fleet else {}, file.find_folder)
    checked_file, problems = validate_value(fleet_tables.value or file.root.value, model)
    problems = [problem for problem in problems if not fleet_tables.is_known(problem)]
    if model is Fleet and any(problem.is_summary for problem in problems):
        problems = _list_by_controller(file.root.value, problems)
    short_problems = [file.problem(problem.place, problem.text) for problem in file.problems]
    if checked_file is None or fleet_tables.problems or file.problems:
        table_problems = [*fleet_tables.problems, *filter(None, map(fleet_tables.locate, problems))]
        located_problems = [
            file.problem(problem.place, problem.text) for problem in problems if not fleet_tables.locate(problem)
        ]
        raise FileError(
            [
                *(FileProblem(problem.file, problem.line, "", problem.text) for problem in table_problems),
                *short_problems,
                *_leave_out_consequences(located_problems, short_problems),
            ]
        )
    return checked_file


def _list_by_controller(value: Mapping[str, Any], summary: Sequence[Problem]) -> list[Problem]:
    """All mistakes of a fleet with too many, by one controller after the other: those of a short form are the same, and
    only together too many. summary: the mistakes as they are, which stand where it is not for the controllers."""
    controllers: Mapping[str, Any] = value["controllers"] if isinstance(value.get("controllers"), dict) else {}
    single_problems = [
        replace(problem, place=("controllers", name, *problem.place))
        for name, fields in controllers.items()
        for problem in validate_part(fields, Controller)[1]
    ]
    if not single_problems:
        return [*summary]
    first_wrong = str(single_problems[0].place[1])
    one_controller = {**value, "controllers": {first_wrong: controllers[first_wrong]}}
    _, section_problems = validate_part(one_controller, Fleet, context=WITHOUT_REFERENCES)
    return [*single_problems, *section_problems, *find_reference_problems(value)]


def _leave_out_consequences(problems: Sequence[FileProblem], short: Sequence[FileProblem]) -> list[FileProblem]:
    """The mistakes but for those that a wrong short form has left at its place."""
    wrong_fields = {problem.field for problem in short}
    return [problem for problem in problems if not wrong_fields & {*_list_fields_above(problem.field)}]


def _list_fields_above(field: str) -> Iterator[str]:
    """A field and all that contain it: `groups.a[1]`, `groups.a`, `groups`."""
    yield field
    for separator in _SEPARATOR.finditer(field):
        yield field[: separator.start()]


def require_mapping(file: LoadedFile, model: type[Model]) -> None:
    """Raises `FileError` for a file that is no mapping, and so has no fields."""
    if not isinstance(file.root.children, dict):
        text = f"must be a mapping that starts with `schema:`, e.g. {_example_line(model)}"
        raise FileError([FileProblem(file.name, 1, "", text)])
    _require_kind(file, model)


def _require_kind(file: LoadedFile, model: type[Model]) -> None:
    """Raises `FileError`, and nothing about the fields, for a fleet file in place of a job file, or the reverse."""
    schema, example = str(file.root.value.get("schema")), _example_line(model)
    kind = next((kind for kind in ("fleet", "fragment", "job") if schema.startswith(f"tutti.{kind}/")), None)
    if kind is not None and f"tutti.{kind}/" not in example:
        needed_kind = "fleet" if model is Fleet else "job"
        problem = file.problem(("schema",), f"this is a {kind} file; a {needed_kind} file is needed here: {example}")
        raise FileError([problem])


def validate_value(value: Mapping[str, Any], model: type[M]) -> tuple[M | None, list[Problem]]:
    """Make a model of the plain value of a whole file; or None, and every mistake."""
    checked_value, problems = validate_part(value, model)
    if "schema" not in value:  # in Python a job needs none: there its version is that of the program
        return None, [Problem(("schema",), "is missing"), *problems]
    return checked_value, problems


def validate_part(
    value: Mapping[str, Any], model: type[M], *, context: object = None
) -> tuple[M | None, list[Problem]]:
    """Make a model of plain values, which may be a part of a file; or None, and every mistake. context: for the
    validators of the model."""
    try:
        # As JSON, because that is where pydantic is strict about text and numbers, but not about enums and lists.
        return model.model_validate_json(json.dumps(value), strict=True, context=context), []
    except ValidationError as error:
        return None, list_problems(error, model)


def _make_file_error(error: YamlError, name: str) -> FileError:
    return FileError(_locate_problem(problem, name) for problem in error.problems)


def _locate_problem(problem: YamlProblem, name: str) -> FileProblem:
    return FileProblem(problem.file or name, problem.line, format_place(problem.path), problem.text)


def _example_line(model: type[Model]) -> str:
    return "`schema: tutti.fleet/1`" if model is Fleet else "`schema: tutti.job/1`"


def format_place(path: Iterable[str | int]) -> str:
    """A place as people write it: `steps[2].to.gantry.x`."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _find_tags(node: YamlNode) -> list[Any]:
    """The values of the fields that select the kind of a mapping."""
    fields = node.children if isinstance(node.children, dict) else {}
    return [fields[key].value for key in ("do", "kind", "type") if key in fields]


def _locate(root: YamlNode, location: Sequence[str | int]) -> tuple[YamlNode, str, str]:
    """Find the node at `location`, its path as text, and this path as a short form has it, empty without one.

    pydantic adds union tags (`move`, `tcp`) and `[key]` marks, which the file does not have: they are skipped. A last
    part that is not in the file, a missing field, belongs to the path.
    """
    node, path, keys = root, list[str | int](), list[str | int]()
    absent: str | int | None = None
    is_short = False
    tagged_node: YamlNode | None = None
    for part in location:
        if node is not tagged_node and part in _find_tags(node):
            tagged_node = node  # `output` is the kind of a step, and also one of its fields
            continue
        entry_below = node.find_child(part)
        if entry_below is None:
            absent = part
            continue
        absent = None
        node = entry_below
        path.append(part if isinstance(part, int) else str(part))
        keys.append(path[-1] if node.written is None else node.written)
        is_short = is_short or node.written is not None
    if isinstance(absent, str) and not absent.startswith("[") and isinstance(node.children, dict):
        path.append(absent)
        keys.append(absent)
    return node, format_place(path), format_place(keys) if is_short else ""
