"""Expands the tree of a fleet file: entries with `count` or `each` become their members, variables their values."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from orchestrator.model.expansion.members import COUNT, EACH, ITEM, MemberError, list_members
from orchestrator.model.expansion.variables import VariableError, Variables, fill_text, is_variable_name
from orchestrator.model.files.yaml_reader import MAX_ENTRIES, YamlError, YamlNode, YamlProblem
from orchestrator.model.problems import Problem

# What users define below is theirs alone: `each` is an ordinary key there.
FREE_SECTIONS = frozenset(("options", "integrations"))

MAX_EXPANDED = 500_000  # values of a whole fleet
Place = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class Scope:
    """Where an entry stands. file: empty for the fleet file itself, else that of a fragment. variables: None outside
    all short forms, where braces are ordinary text. is_free: in a section of users."""

    file: str = ""
    variables: Variables | None = None
    is_free: bool = False
    used: set[str] = field(default_factory=set[str])

    def add(self, variables: Variables) -> "Scope":
        """This scope with further variables, which hide those of the same names."""
        return replace(self, variables={**(self.variables or {}), **variables})


class TreeExpander:
    """Expands trees. problems: mistakes of single entries; their places are those of the expanded tree. failures:
    what could not be expanded at all."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self.failures: list[YamlProblem] = []
        self._places: set[Place] = set()  # of problems
        self._count = 0

    def note_problem(self, place: Place, text: str) -> None:
        """Add a mistake of one entry."""
        self._places.add(place)
        self.problems.append(Problem(place, text))

    def expand(self, node: YamlNode, scope: Scope, place: Place) -> YamlNode:
        """The expanded copy of a node. Raises `YamlError` for a tree that becomes too large."""
        self._count += 1
        if self._count > MAX_EXPANDED:
            raise _too_large(node, scope, place, f"makes more than {MAX_EXPANDED} values")
        if node.children is None:
            return self._fill(node, scope, place)
        expanded_node = YamlNode(node.line, children={} if isinstance(node.children, dict) else [], file=scope.file)
        if self._is_bare_variable(node, scope):
            self.note_problem(place, f'write a variable that stands alone in quotes: "{{{next(iter(node.value))}}}"')
        self.extend(expanded_node, node, scope, place)
        expanded_node.update_value()
        return expanded_node

    def extend(self, target: YamlNode, node: YamlNode, scope: Scope, place: Place) -> None:
        """Add the expanded entries of a mapping or list to another one. Raises `YamlError`."""
        if isinstance(target.children, dict) and isinstance(node.children, dict):
            self._extend_mapping(target.children, node, scope, place)
        elif isinstance(target.children, list) and isinstance(node.children, list):
            self._extend_list(target.children, node, scope, place)

    def list_entry(self, node: YamlNode, scope: Scope, place: Place) -> Iterator[tuple[YamlNode, Scope]]:
        """An entry, or, where it is written in short, the same once for each member, with its variables."""
        fields = node.children
        if scope.is_free or not isinstance(fields, dict) or not fields.keys() & {COUNT, EACH}:
            yield node, scope
            return
        other_fields = {key: child for key, child in fields.items() if key not in (COUNT, EACH)}
        body = YamlNode(node.line, children=other_fields)
        if ITEM in other_fields:
            body = other_fields[ITEM]
            if len(other_fields) > 1:
                text = "beside `item` nothing but `count` or `each` has a meaning; write the fields into it"
                self.note_problem(place, text)
        controls = {
            key: self.expand(fields[key], replace(scope, is_free=True), place) for key in (COUNT, EACH) if key in fields
        }
        try:
            members = list_members(controls)
        except MemberError as error:
            line, key = fields[error.key].line, error.key
            self.failures.append(YamlProblem(line, (*place, key), str(error), scope.file))
            return
        for variables in members:
            yield from self.list_entry(body, scope.add(variables), place)

    def _extend_mapping(self, children: dict[str, YamlNode], node: YamlNode, scope: Scope, place: Place) -> None:
        assert isinstance(node.children, dict)
        for key, child in node.children.items():
            for body, member_scope in self.list_entry(child, scope, (*place, key)):
                name = str(self._fill_text(key, member_scope, (*place, key)))
                inner_scope = replace(member_scope, is_free=scope.is_free or key in FREE_SECTIONS)
                entry = self.expand(body, inner_scope, (*place, name))
                entry.line = child.line
                entry.written = key if member_scope.variables is not None else None
                self._add_entry(children, name, entry, (*place, name))
                self._require_space(len(children), child, scope, place)

    def _extend_list(self, children: list[YamlNode], node: YamlNode, scope: Scope, place: Place) -> None:
        for number, child in node.entries():
            for body, member_scope in self.list_entry(child, scope, (*place, len(children))):
                entry = self.expand(body, member_scope, (*place, len(children)))
                entry.written = number if member_scope.variables is not None else None
                children.append(entry)
                self._require_space(len(children), child, scope, place)

    def _add_entry(self, children: dict[str, YamlNode], name: str, entry: YamlNode, place: Place) -> None:
        first_entry = children.setdefault(name, entry)
        if first_entry is entry or place in self._places:
            return  # a variable that is not there leaves several entries with one name
        lines = " and ".join(f"{twin.file or 'line'} {twin.line}" for twin in (first_entry, entry))
        text = f"is there twice, from {lines}; give each its own name, with all variables that change in it"
        self.note_problem(place, text)

    def _require_space(self, number: int, node: YamlNode, scope: Scope, place: Place) -> None:
        if number > MAX_ENTRIES:
            raise _too_large(node, scope, place, f"has more than {MAX_ENTRIES} entries")

    def _fill(self, node: YamlNode, scope: Scope, place: Place) -> YamlNode:
        value = self._fill_text(node.value, scope, place) if isinstance(node.value, str) else node.value
        text = node.text if value is node.value else str(value)
        return YamlNode(node.line, value, text=text, file=scope.file)

    def _fill_text(self, text: str, scope: Scope, place: Place) -> object:
        if scope.variables is None:
            return text
        try:
            return fill_text(text, scope.variables, scope.used)
        except VariableError as error:
            self.note_problem(place, str(error))
            return text

    def _is_bare_variable(self, node: YamlNode, scope: Scope) -> bool:
        """Whether a mapping is `{n}` without quotes, which is a mapping to YAML."""
        entries = list(node.entries())
        name, child = entries[0] if len(entries) == 1 else ("", node)
        is_empty = child.value is None and child.text == "" and child.children is None
        return scope.variables is not None and is_empty and str(name) in scope.variables and is_variable_name(str(name))


def _too_large(node: YamlNode, scope: Scope, place: Place, text: str) -> YamlError:
    return YamlError([YamlProblem(node.line, place, f"{text} when it is expanded", scope.file)])
