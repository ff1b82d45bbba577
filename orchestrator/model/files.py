"""Reading fleet and job files: YAML in, models out, and errors that name file, line, field and remedy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import yaml
from pydantic import ValidationError
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from orchestrator.model.base import Model, UnknownName
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import Job

M = TypeVar("M", bound=Model)

# C loader where PyYAML has it: a job of 10,000 steps takes a tenth of the time.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong in a file. line counts from 1; field is the path of keys, e.g. `steps[2].to`."""

    file: str
    line: int
    field: str
    text: str

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}"
        return f"{where}: {self.field}: {self.text}" if self.field else f"{where}: {self.text}"


class FileError(ValueError):
    """A file that can not be used. Its text lists every problem, one a line."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__("\n".join(str(problem) for problem in problems))
        self.problems = tuple(problems)


def load_fleet(path: Path) -> Fleet:
    """The fleet file at `path`. Raises `FileError`."""
    return _load(path, Fleet)


def load_job(path: Path) -> Job:
    """The job file at `path`. Raises `FileError`."""
    return _load(path, Job)


def _load(path: Path, model: type[M]) -> M:
    name = str(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError([Problem(name, 1, "", f"can not be read: {error.strerror}")]) from None
    except UnicodeDecodeError as error:
        raise FileError([Problem(name, 1, "", f"is not UTF-8 text (byte {error.start})")]) from None
    return parse(text, model, name)


def parse(text: str, model: type[M], name: str) -> M:
    """`text` as YAML for `model`; `name` stands for the file in errors. Raises `FileError`."""
    try:
        loader: Any = _Loader(text)
        root: Node | None = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        raise FileError([Problem(name, line, "", f"not YAML: {error.problem or error.context}")]) from None
    except yaml.YAMLError as error:
        raise FileError([Problem(name, 1, "", f"not YAML: {error}")]) from None
    if not isinstance(root, MappingNode):
        raise FileError([Problem(name, 1, "", f"must be a mapping with `schema:` first, e.g. {_example(model)}")])
    twice = list(_duplicate_keys(root, name, ""))
    if twice:
        raise FileError(twice)
    data: Any = loader.construct_document(root)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise FileError([_problem(cast(Mapping[str, Any], each), root, name) for each in error.errors()]) from None


def _example(model: type[Model]) -> str:
    return "`schema: tutti.fleet/1`" if model is Fleet else "`schema: tutti.job/1`"


def _duplicate_keys(node: Node, name: str, path: str) -> "list[Problem]":
    problems: list[Problem] = []
    if isinstance(node, MappingNode):
        seen: dict[str, int] = {}
        for key, value in node.value:
            text = str(key.value)
            field = f"{path}.{text}" if path else text
            line = key.start_mark.line + 1
            if text in seen:
                problems.append(Problem(name, line, field, f"is given twice; it stands already in line {seen[text]}"))
            seen[text] = line
            problems += _duplicate_keys(value, name, field)
    elif isinstance(node, SequenceNode):
        for index, value in enumerate(node.value):
            problems += _duplicate_keys(value, name, f"{path}[{index}]")
    return problems


def _problem(error: Mapping[str, Any], root: Node, name: str) -> Problem:
    node, field, tail = _locate(root, error["loc"])
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, UnknownName):
        node = _scalar(node, cause.name) or node
    if tail and error["type"] == "missing":
        field = f"{field}.{tail[-1]}" if field else str(tail[-1])
    return Problem(name, node.start_mark.line + 1, field, _explain(error))


def _scalar(node: Node, text: str) -> Node | None:
    """The first scalar below `node` that reads `text`."""
    if isinstance(node, ScalarNode):
        return node if node.value == text else None
    below: list[Node] = []
    if isinstance(node, MappingNode):
        below = [part for pair in node.value for part in pair]
    elif isinstance(node, SequenceNode):
        below = node.value
    return next((found for part in below if (found := _scalar(part, text))), None)


def _locate(root: Node, location: Sequence[str | int]) -> tuple[Node, str, list[str | int]]:
    """The node that pydantic's `location` names, its path as text, and the parts that the file does not have.

    Tags of unions (`move`, `tcp`) and `[key]` marks stand in the location but not in the file; they are skipped.
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
        # The line of the key, not of a block that starts below it, unless there is more to descend to.
        node = value
        if isinstance(key, ScalarNode) and not isinstance(value, ScalarNode):
            node.start_mark = key.start_mark
    return node, field, absent


def _explain(error: Mapping[str, Any]) -> str:
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
        return f"needs the field {context['discriminator']}, which says what it is"
    if kind == "string_pattern_mismatch":
        return f"found {found!r}; an id has only the characters a-z, 0-9, _ and -"
    message = str(error["msg"])
    shown = repr(found)
    return f"found {shown if len(shown) < 60 else shown[:57] + '…'}; {message[0].lower()}{message[1:]}"
