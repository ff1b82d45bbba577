"""Read YAML as the core schema of YAML 1.2.2 (chapter 10.3) defines it, in bounded time and memory.

`010` is ten, `1:30`, `1_000`, `no` and `on` are text, as in the JSON that such files also may be. The document is built
from the parser's events, so that every bound holds before anything is composed: a deep, huge, or self-repeating
document ends with a message that names the line.
"""

import re
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import yaml
from yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    DocumentStartEvent,
    Event,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
    SequenceStartEvent,
)

from orchestrator.model.errors import TuttiError

MAX_BYTES = 16 * 1024 * 1024
MAX_DEPTH = 32
MAX_NODES = 1_000_000  # with every alias counted as all that it stands for
MAX_ENTRIES = 10_000  # of one list or mapping
MAX_ALIASES = 1_000
MAX_NUMBER_LENGTH = 60  # characters

# The C parser, where PyYAML has it, is ten times as fast. Both produce the same events.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_NULL = frozenset(("", "~", "null", "Null", "NULL"))
_BOOL = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INT = re.compile(r"[-+]?[0-9]+\Z")
_OTHER_INT = re.compile(r"0o[0-7]+\Z|0x[0-9a-fA-F]+\Z")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_INFINITE = re.compile(r"([-+]?)\.(inf|Inf|INF)\Z")
_NAN = frozenset((".nan", ".NaN", ".NAN"))
_VARIABLE = re.compile(r"(?<=[^\s{\[,:])\{[a-z][a-z0-9_]*([+-][0-9]+)?\}")  # of a fleet file, after other text
_NUMBER_START = frozenset("0123456789+-.")

_BOMS = {
    b"\xff\xfe\x00\x00": "UTF-32",
    b"\x00\x00\xfe\xff": "UTF-32",
    b"\xff\xfe": "UTF-16",
    b"\xfe\xff": "UTF-16",
}


@dataclass(frozen=True, slots=True)
class YamlProblem:
    """One mistake in a document. line: counts from 1. path: keys and indices that lead to it. file: another one than
    that which is read, a fragment of it."""

    line: int
    path: tuple[str | int, ...]
    text: str
    file: str = ""


class YamlError(TuttiError, ValueError):
    """A document that cannot be used, with all of its mistakes that were found. is_unread: the file cannot be read."""

    def __init__(self, problems: list[YamlProblem], *, is_unread: bool = False) -> None:
        super().__init__("\n".join(f"line {problem.line}: {problem.text}" for problem in problems))
        self.problems = problems
        self.is_unread = is_unread


@dataclass(slots=True)
class YamlNode:
    """A value with the place where it stands.

    line: of its key, else of itself; counts from 1. children: by key or index, None for a scalar. text: a scalar as it
    is written. size: number of nodes below and with it. file: that it is from; empty: the document itself. written: the
    key or index of an expanded entry as its file has it, e.g. `stage-{n}`; None: the same.
    """

    line: int
    value: Any = None
    children: "dict[str, YamlNode] | list[YamlNode] | None" = None
    text: str = ""
    size: int = 1
    file: str = ""
    written: str | int | None = None

    def update_value(self) -> None:
        """Make the value of a mapping or list from those of its children."""
        if isinstance(self.children, dict):
            self.value = {key: child.value for key, child in self.children.items()}
        elif self.children is not None:
            self.value = [child.value for child in self.children]

    def entries(self) -> "Iterator[tuple[str | int, YamlNode]]":
        """Keys or indices with their nodes."""
        if isinstance(self.children, dict):
            return iter(self.children.items())
        return iter(enumerate(self.children or ()))

    def find_child(self, part: str | int) -> "YamlNode | None":
        """The node at a key or index; None if there is none."""
        if isinstance(self.children, dict):
            return self.children.get(str(part))
        number = int(part) if str(part).isdecimal() else -1
        items = self.children or []
        return items[number] if 0 <= number < len(items) else None


def decode_text(data: bytes, most: int = MAX_BYTES) -> str:
    """Decode the bytes of a file, at most `most`. Raises `YamlError` for any encoding but UTF-8."""
    if len(data) > most:
        raise _single(1, f"has {len(data)} bytes; the maximum is {most}")
    if mark := explain_mark(data):
        raise _single(1, mark)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise _single(line, explain_byte(data[error.start])) from None


def explain_mark(data: bytes) -> str:
    """What is wrong with a text that begins with the mark of another encoding; empty: nothing."""
    name = next((name for mark, name in _BOMS.items() if data.startswith(mark)), "")
    return name and f"is {name} text; save it as UTF-8"


def explain_byte(byte: int) -> str:
    """What is wrong with a byte that is no UTF-8."""
    return f"byte 0x{byte:02x} is not UTF-8 text; save the file as UTF-8 (in Windows-1252, 0xb5 is µ)"


def read_yaml_file(path: Path) -> YamlNode:
    """Read the one document in the file at `path`, in bounded time and memory. Raises `YamlError`."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        text = error.strerror if isinstance(error, OSError) else error
        raise YamlError([YamlProblem(1, (), f"cannot be read: {text}")], is_unread=True) from None
    return read_yaml(decode_text(data))


def read_yaml(text: str) -> YamlNode:
    """Read the one document in `text`. Raises `YamlError`."""
    if len(text) > MAX_BYTES:
        raise _single(1, f"has {len(text)} characters; the maximum is {MAX_BYTES}")
    reader = _DocumentReader()
    try:
        for event in cast("Generator[Event]", yaml.parse(text, Loader=_Loader)):
            reader.take(event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = " ".join(str(part) for part in (error.problem, error.context) if part)
        hint = _suggest_quotes(text, mark.line) if mark else ""
        reader.problems.append(YamlProblem(mark.line + 1 if mark else 1, (), f"not YAML: {problem}{hint}"))
    except yaml.reader.ReaderError as error:
        position = error.position if isinstance(error.position, int) else 0  # pyright: ignore[reportUnnecessaryIsInstance]
        line = text.count("\n", 0, position) + 1
        reader.problems.append(YamlProblem(line, (), f"not YAML: {error.reason}"))
    except yaml.YAMLError as error:
        reader.problems.append(YamlProblem(1, (), f"not YAML: {error}"))
    except _BoundExceeded as error:
        reader.problems.append(error.problem)
    if reader.problems:
        raise YamlError(reader.problems)
    return reader.root or YamlNode(1)


def resolve_plain(text: str) -> Any:
    """The value of a plain scalar by the core schema: null, bool, int, float, or `text` itself.

    Raises `ValueError` for a number that is too long to be one.
    """
    if text in _NULL:
        return None
    if text[0] not in _NUMBER_START:
        return _BOOL.get(text, text)
    if _INT.match(text):
        return int(_bounded(text))
    if _FLOAT.match(text):
        return float(_bounded(text))
    if _OTHER_INT.match(text):
        return int(_bounded(text), 0)
    if (infinite := _INFINITE.match(text)) is not None:
        return float(f"{infinite[1]}inf")
    return float("nan") if text in _NAN else text


def _bounded(text: str) -> str:
    if len(text) > MAX_NUMBER_LENGTH:
        raise ValueError(f"a number of {len(text)} characters; the maximum is {MAX_NUMBER_LENGTH}")
    return text


class _BoundExceeded(TuttiError):
    """A bound is exceeded: reading ends."""

    def __init__(self, problem: YamlProblem) -> None:
        super().__init__(problem.text)
        self.problem = problem


@dataclass(slots=True)
class _OpenBlock:
    """A list or mapping that has begun. key: read, its value is not. anchor: its name, for aliases."""

    node: YamlNode
    anchor: str | None
    key: str | None = None
    key_line: int = 0
    in_braces: bool = False
    last: YamlNode | None = None


@dataclass(slots=True)
class _DocumentReader:
    """Builds nodes from events; `problems` collects what is wrong without ending the document."""

    root: YamlNode | None = None
    problems: list[YamlProblem] = field(default_factory=list[YamlProblem])
    _open: list[_OpenBlock] = field(default_factory=list[_OpenBlock])
    _anchors: dict[str, YamlNode | None] = field(default_factory=dict[str, "YamlNode | None"])
    _nodes: int = 0
    _aliases: int = 0
    _documents: int = 0

    def take(self, event: Event) -> None:
        """Take the next event of the parser."""
        if isinstance(event, NodeEvent):
            self._take_node(event, _line_of(event))
        elif isinstance(event, CollectionEndEvent):
            self._close_block()
        elif isinstance(event, DocumentStartEvent):
            self._documents += 1
            if self._documents > 1:
                text = "a second document begins here; write one document per file"
                raise _BoundExceeded(YamlProblem(_line_of(event), (), text))

    def _take_node(self, event: NodeEvent, line: int) -> None:
        block = self._open[-1] if self._open else None
        if block is not None and isinstance(block.node.children, dict) and block.key is None:
            self._take_key(event, block, line)
            return
        if isinstance(event, AliasEvent):
            self._add_node(self._find_anchor(str(event.anchor), line))
            return
        if event.anchor is not None:
            self._anchors[str(event.anchor)] = None
        if isinstance(event, ScalarEvent):
            node = self._read_scalar(event, line)
            self._note_anchor(event.anchor, node)
            self._add_node(node)
        elif isinstance(event, MappingStartEvent | SequenceStartEvent):
            self._check_tag(event, line)
            if len(self._open) >= MAX_DEPTH:
                raise _BoundExceeded(YamlProblem(line, self._path(), f"is nested deeper than {MAX_DEPTH} levels"))
            node = YamlNode(line, children={} if isinstance(event, MappingStartEvent) else [])
            self._open.append(_OpenBlock(node, event.anchor, in_braces=bool(event.flow_style)))

    def _take_key(self, event: NodeEvent, block: _OpenBlock, line: int) -> None:
        """Take the key of the next entry of a mapping; keys are the text that is written."""
        if not isinstance(event, ScalarEvent):
            raise _BoundExceeded(
                YamlProblem(line, self._path(), "a key must be a word, not a list, a mapping or an alias")
            )
        self._check_tag(event, line)
        key = str(event.value)
        if key == "<<" and event.implicit[0]:
            text = "merge keys (`<<`) are not used; write the fields out, or use an alias for the whole block"
            self.problems.append(YamlProblem(line, self._path(), text))
        earlier_child = cast("dict[str, YamlNode]", block.node.children).get(key)
        if earlier_child is not None:
            text = f"is given twice; the first one is in line {earlier_child.line}"
            self.problems.append(YamlProblem(line, (*self._path(), key), text))
        block.key, block.key_line = key, line

    def _read_scalar(self, event: ScalarEvent, line: int) -> YamlNode:
        self._check_tag(event, line)
        text = str(event.value)
        value: Any = text
        if event.implicit[0]:
            try:
                value = resolve_plain(text)
            except ValueError as error:
                self.problems.append(YamlProblem(line, self._path(), str(error)))
        return YamlNode(line, value, text=text)

    def _check_tag(self, event: Any, line: int) -> None:
        if event.tag is not None:
            text = f"tags are not used; remove {str(event.tag)[:40]!r} (text is written in quotes)"
            self.problems.append(YamlProblem(line, self._path(), text))

    def _find_anchor(self, name: str, line: int) -> YamlNode:
        self._aliases += 1
        if self._aliases > MAX_ALIASES:
            raise _BoundExceeded(YamlProblem(line, self._path(), f"the file has more than {MAX_ALIASES} aliases"))
        if name not in self._anchors:
            raise _BoundExceeded(YamlProblem(line, self._path(), f"alias *{name} has no anchor &{name} before it"))
        node = self._anchors[name]
        if node is None:
            raise _BoundExceeded(YamlProblem(line, self._path(), f"alias *{name} is inside its own anchor &{name}"))
        return YamlNode(line, node.value, node.children, node.text, node.size)

    def _note_anchor(self, name: str | None, node: YamlNode) -> None:
        if name is not None:
            self._anchors[str(name)] = node

    def _add_node(self, node: YamlNode) -> None:
        """Put a complete node where it belongs."""
        self._nodes += node.size
        if self._nodes > MAX_NODES:
            raise _BoundExceeded(YamlProblem(node.line, self._path(), f"the file has more than {MAX_NODES} values"))
        if not self._open:
            self.root = node
            return
        block = self._open[-1]
        children = block.node.children
        assert children is not None
        if len(children) >= MAX_ENTRIES:
            text = f"has more than {MAX_ENTRIES} entries; split it, e.g. into several jobs"
            raise _BoundExceeded(YamlProblem(node.line, self._path(inside=False), text))
        if isinstance(children, dict):
            key = block.key
            assert key is not None
            self._check_comma(block, key, node)
            node.line = block.key_line
            children[key] = node
            block.key, block.last = None, node
        else:
            children.append(node)

    def _check_comma(self, block: _OpenBlock, key: str, node: YamlNode) -> None:
        """`{gantry.x: 1,5}` is two entries to YAML, the second a key without a value."""
        node_before = block.last
        if not block.in_braces or node_before is None or node.text or node.children is not None:
            return
        if key.isdecimal() and isinstance(node_before.value, int | float) and node_before.children is None:
            text = f"a comma separates entries; write the number with a point: {node_before.text}.{key}"
            self.problems.append(YamlProblem(block.key_line, (*self._path(inside=False), key), text))

    def _close_block(self) -> None:
        block = self._open.pop()
        node = block.node
        node.update_value()
        node.size += sum(child.size for _, child in node.entries())
        self._note_anchor(block.anchor, node)
        # Its children are counted already.
        size, node.size = node.size, 1
        self._add_node(node)
        node.size = size

    def _path(self, *, inside: bool = True) -> tuple[str | int, ...]:
        """Where the reader is. inside: with the entry that is being read of the innermost block."""
        parts: list[str | int] = []
        for number, block in enumerate(self._open):
            if not inside and number == len(self._open) - 1:
                break
            if isinstance(block.node.children, list):
                parts.append(len(block.node.children))
            elif block.key is not None:
                parts.append(block.key)
        return tuple(parts)


def _suggest_quotes(text: str, line: int) -> str:
    """The remedy for `{gantry.x: ${width}}`, in which YAML takes the second `{` for a mapping; empty elsewhere."""
    lines = text.splitlines()
    if not 0 <= line < len(lines):
        return ""
    if "${" not in lines[line]:
        variable = _VARIABLE.search(lines[line])
        return "" if variable is None else f"; inside braces and brackets write a value with {variable[0]} in quotes"
    return '; inside braces and brackets write a parameter in quotes: "${name}"'


def _line_of(event: Event) -> int:
    mark = event.start_mark
    return 1 if mark is None else mark.line + 1


def _single(line: int, text: str) -> YamlError:
    return YamlError([YamlProblem(line, (), text)])
