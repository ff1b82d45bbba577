"""Read fleet and job files: YAML in, models out; errors name file, line, field and remedy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import yaml
from pydantic import ValidationError
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from orchestrator.model.base import Model, UnknownName
from orchestrator.model.errors import TuttiError
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import Job

M = TypeVar("M", bound=Model)

# The C loader, where PyYAML has it, reads a job of 10,000 steps in a tenth of the time.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True, slots=True)
class FileProblem:
    """One mistake in a file. line: counts from 1. field: the path of keys, e.g. `steps[2].to`."""

    file: str
    line: int
    field: str
    text: str

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}"
        return f"{where}: {self.field}: {self.text}" if self.field else f"{where}: {self.text}"


class FileError(TuttiError, ValueError):
    """A file that cannot be used. The text lists all problems, one per line."""

    def __init__(self, problems: Sequence[FileProblem]) -> None:
        super().__init__("\n".join(str(problem) for problem in problems))
        self.problems = tuple(problems)


def load_fleet(path: Path) -> Fleet:
    """Load the fleet file at `path`. Raises `FileError`."""
    return _load_model(path, Fleet)


def load_job(path: Path) -> Job:
    """Load the job file at `path`. Raises `FileError`."""
    return _load_model(path, Job)


def _load_model(path: Path, model: type[M]) -> M:
    name = str(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError([FileProblem(name, 1, "", f"cannot be read: {error.strerror}")]) from None
    except UnicodeDecodeError as error:
        raise FileError([FileProblem(name, 1, "", f"is not UTF-8 text (byte {error.start})")]) from None
    return parse_document(text, model, name)


def parse_document(text: str, model: type[M], name: str) -> M:
    """Parse `text` as YAML for `model`. name: stands for the file in errors. Raises `FileError`."""
    try:
        loader: Any = _Loader(text)
        root: Node | None = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        raise FileError([FileProblem(name, line, "", f"not YAML: {error.problem or error.context}")]) from None
    except yaml.YAMLError as error:
        raise FileError([FileProblem(name, 1, "", f"not YAML: {error}")]) from None
    if not isinstance(root, MappingNode):
        raise FileError(
            [FileProblem(name, 1, "", f"must be a mapping that starts with `schema:`, e.g. {_example_line(model)}")]
        )
    twice = list(_find_duplicate_keys(root, name, ""))
    if twice:
        raise FileError(twice)
    data: Any = loader.construct_document(root)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise FileError([_make_problem(cast(Mapping[str, Any], each), root, name) for each in error.errors()]) from None


def _example_line(model: type[Model]) -> str:
    return "`schema: tutti.fleet/1`" if model is Fleet else "`schema: tutti.job/1`"


def _find_duplicate_keys(node: Node, name: str, path: str) -> "list[FileProblem]":
    problems: list[FileProblem] = []
    if isinstance(node, MappingNode):
        seen: dict[str, int] = {}
        for key, value in node.value:
            text = str(key.value)
            field = f"{path}.{text}" if path else text
            line = key.start_mark.line + 1
            if text in seen:
                problems.append(
                    FileProblem(name, line, field, f"is given twice; the first one is in line {seen[text]}")
                )
            seen[text] = line
            problems += _find_duplicate_keys(value, name, field)
    elif isinstance(node, SequenceNode):
        for index, value in enumerate(node.value):
            problems += _find_duplicate_keys(value, name, f"{path}[{index}]")
    return problems


def _make_problem(error: Mapping[str, Any], root: Node, name: str) -> FileProblem:
    node, field, tail = _locate_node(root, error["loc"])
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, UnknownName):
        node = _find_scalar(node, cause.name) or node
    if tail and error["type"] == "missing":
        field = f"{field}.{tail[-1]}" if field else str(tail[-1])
    return FileProblem(name, node.start_mark.line + 1, field, _explain_error(error))


def _find_scalar(node: Node, text: str) -> Node | None:
    """Find the first scalar below `node` with the value `text`."""
    if isinstance(node, ScalarNode):
        return node if node.value == text else None
    below: list[Node] = []
    if isinstance(node, MappingNode):
        below = [part for pair in node.value for part in pair]
    elif isinstance(node, SequenceNode):
        below = node.value
    return next((found for part in below if (found := _find_scalar(part, text))), None)


def _locate_node(root: Node, location: Sequence[str | int]) -> tuple[Node, str, list[str | int]]:
    """Find the node that pydantic's `location` names; also its path as text, and the parts that are not in the file.

    pydantic adds union tags (`move`, `tcp`) and `[key]` marks to a location; the file does not have them, so they are
    skipped.
    """
    node, field, absent = root, "", list[str | int]()
    for part in location:
        found: tuple[Node, Node] | None = None
        if isinstance(node, MappingNode):
            found = next(((key, value) for key, value in node.value if str(key.value) == str(part)), None)
        elif isinstance(node, SequenceNode) and isinstance(part, int) and part < len(node.value):
            found = (node.value[part], node.value[part])
        if found is None:
            absent.append(part)
            continue
        absent.clear()
        key, value = found
        field = f"{field}[{part}]" if isinstance(part, int) else f"{field}.{part}" if field else str(part)
        # Report the line of the key, not of the block that starts below it, unless the location goes deeper.
        node = value
        if isinstance(key, ScalarNode) and not isinstance(value, ScalarNode):
            node.start_mark = key.start_mark
    return node, field, absent


def _explain_error(error: Mapping[str, Any]) -> str:
    kind, context = error["type"], error.get("ctx", {})
    found = error.get("input")
    if kind == "missing":
        return "is missing"
    if kind == "extra_forbidden":
        return "unknown field; see `tutti schema` for the fields that are allowed here"
    if kind == "value_error":
        return str(context.get("error", error["msg"]))
    if kind in ("literal_error", "enum"):
        return f"found {found!r}; allowed: {context['expected']}"
    if kind == "union_tag_invalid":
        return f"found {context['tag']!r} for {context['discriminator']}; allowed: {context['expected_tags']}"
    if kind == "union_tag_not_found":
        return f"needs the field {context['discriminator']}, which selects its kind"
    if kind == "string_pattern_mismatch":
        return f"found {found!r}; an id may contain only a-z, 0-9, _ and -"
    message = str(error["msg"])
    shown = repr(found)
    return f"found {shown if len(shown) < 60 else shown[:57] + '…'}; {message[0].lower()}{message[1:]}"
