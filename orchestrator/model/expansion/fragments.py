"""`include`: fragments of fleet files, whose sections are added to those of the file that includes them."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from orchestrator.model.expansion.expander import Place, Scope, TreeExpander
from orchestrator.model.expansion.variables import Variable, Variables, is_variable_name, make_variable
from orchestrator.model.explain import show_value
from orchestrator.model.files.yaml_reader import YamlError, YamlNode, YamlProblem, read_yaml_file
from orchestrator.model.problems import Problem

INCLUDE, DEFAULTS, SCHEMA = "include", "defaults", "schema"
FRAGMENT_SCHEMA = "tutti.fragment/1"
DEEP_SECTIONS = frozenset(("zones",))  # whose entries are one level further down
SECTIONS = ("controllers", "wiring", "permits", "groups", "home_order", "positions", "frames", "virtual", "zones")
MAX_INCLUDES = 5_000
MAX_CHAIN = 8  # fragments in each other


@dataclass(frozen=True, slots=True)
class ExpandedFleet:
    """A fleet file without short forms. problems: mistakes of single entries, by their places in `root`. failures:
    what could not be expanded, so that entries are missing."""

    root: YamlNode
    problems: tuple[Problem, ...] = ()
    failures: tuple[YamlProblem, ...] = ()


@dataclass(frozen=True, slots=True)
class _Inclusion:
    """A fragment that is to be read. node: where it is asked for. chain: the files that lead there, without it."""

    node: YamlNode
    scope: Scope
    place: Place
    path: Path
    values: Variables
    chain: tuple[Path, ...]

    def fail(self, text: str) -> YamlError:
        """A mistake at the place where the fragment is asked for."""
        return YamlError([YamlProblem(self.node.line, self.place, text, self.scope.file)])


@dataclass(slots=True)
class _FleetExpander:
    """Expands one fleet file with its fragments."""

    root: YamlNode
    expander: TreeExpander = field(default_factory=TreeExpander)
    _files: dict[Path, YamlNode] = field(default_factory=dict[Path, YamlNode])
    _resolved: dict[Path, Path] = field(default_factory=dict[Path, Path])
    _count: int = 0

    def add_sections(self, node: YamlNode, scope: Scope, names: Iterable[str]) -> None:
        """Add the sections of a file to those that are there. Raises `YamlError`."""
        assert isinstance(node.children, dict)
        for name in names:
            self._add_section(self.root, name, node.children[name], scope, (name,))

    def _add_section(self, parent: YamlNode, name: str, node: YamlNode, scope: Scope, place: Place) -> None:
        assert isinstance(parent.children, dict)
        section = parent.children.get(name)
        if node.children is None or (section is not None and type(section.children) is not type(node.children)):
            if section is None:
                parent.children[name] = self.expander.expand(node, scope, place)
            else:
                text = f"stands in {scope.file or 'the fleet file'} too, line {node.line}; leave one of the two out"
                self.expander.note_problem(place, text)
            return
        if section is None:
            section = YamlNode(node.line, children={} if isinstance(node.children, dict) else [], file=scope.file)
            parent.children[name] = section
        if name in DEEP_SECTIONS and isinstance(node.children, dict):
            for key, child in node.children.items():
                self._add_section(section, key, child, scope, (*place, key))
        else:
            section_scope = Scope(scope.file, scope.variables, name == "integrations", scope.used)
            self.expander.extend(section, node, section_scope, place)
        section.update_value()

    def include_all(self, node: YamlNode, scope: Scope, chain: tuple[Path, ...]) -> None:
        """Add the fragments that a file names in `include`. Raises `YamlError`."""
        include = node.find_child(INCLUDE)
        if include is None:
            return
        items = include.children if isinstance(include.children, list) else [include]
        for number, item in enumerate(items):
            item_place = (INCLUDE, number) if isinstance(include.children, list) else (INCLUDE,)
            for body, member_scope in self.expander.list_entry(item, scope, item_place):
                try:
                    entry = self.expander.expand(body, member_scope, item_place)
                    self._include(_read_inclusion(entry, member_scope, item_place, chain))
                except YamlError as error:
                    self.expander.failures += error.problems

    def _include(self, inclusion: _Inclusion) -> None:
        self._count += 1
        if self._count > MAX_INCLUDES:
            raise inclusion.fail(f"more than {MAX_INCLUDES} fragments are included")
        fragment = self._read_fragment(inclusion)
        values = {**_read_values(fragment.find_child(DEFAULTS), (DEFAULTS,), str(inclusion.path)), **inclusion.values}
        scope = Scope(str(inclusion.path), values)
        names = [name for name in fragment.value if name in SECTIONS]
        self.add_sections(fragment, scope, names)
        self.include_all(fragment, scope, (*inclusion.chain, inclusion.path))
        unused_names = [name for name in inclusion.values if name not in scope.used]
        if unused_names:
            known_names = ", ".join(sorted(scope.used | values.keys() - set(unused_names))) or "none"
            raise inclusion.fail(f"{inclusion.path} has no variable {unused_names[0]}; its variables: {known_names}")

    def _resolve(self, path: Path) -> Path:
        """What identifies a file, however it is named; it costs system calls, and so is kept."""
        if path not in self._resolved:
            self._resolved[path] = path.resolve()
        return self._resolved[path]

    def _read_fragment(self, inclusion: _Inclusion) -> YamlNode:
        """The fragment, read once and checked. Raises `YamlError`."""
        path, names = inclusion.path, [str(path) for path in inclusion.chain]
        key = self._resolve(path)
        if key in map(self._resolve, inclusion.chain):
            raise inclusion.fail(f"includes itself: {' includes '.join([*names, str(path)])}")
        if len(inclusion.chain) > MAX_CHAIN:
            raise inclusion.fail(f"more than {MAX_CHAIN} fragments include each other: {' includes '.join(names)}")
        if key not in self._files:
            try:
                self._files[key] = read_yaml_file(path)
            except YamlError as error:
                if error.is_unread:
                    raise inclusion.fail(
                        f"{path} {error.problems[0].text}; it is looked for beside its own file"
                    ) from None
                raise YamlError([replace(problem, file=str(path)) for problem in error.problems]) from None
            _check_fragment(self._files[key], path)
        return self._files[key]


def expand_fleet(root: YamlNode, path: Path | None) -> ExpandedFleet:
    """Expand a fleet file. path: where it is; None: it arrived as text, and can include nothing. Raises `YamlError`."""
    if not isinstance(root.children, dict):
        return ExpandedFleet(root)
    include = root.children.get(INCLUDE)
    if include is not None and path is None:
        text = (
            "text without its folder can include nothing; give the whole fleet, as the command `fleet expand` prints it"
        )
        raise YamlError([YamlProblem(include.line, (INCLUDE,), text)])
    work = _FleetExpander(YamlNode(root.line, children={}))
    scope = Scope()
    work.add_sections(root, scope, [name for name in root.children if name != INCLUDE])
    if path is not None:
        work.include_all(root, scope, (path,))
    work.root.update_value()
    return ExpandedFleet(work.root, tuple(work.expander.problems), tuple(work.expander.failures))


def _read_inclusion(node: YamlNode, scope: Scope, place: Place, chain: tuple[Path, ...]) -> _Inclusion:
    """What an entry of `include` asks for: the name of a file, or `{file: …, with: {…}}`. Raises `YamlError`."""
    fields: Mapping[str, YamlNode] = node.children if isinstance(node.children, dict) else {"file": node}
    name = fields["file"].value if "file" in fields else None
    unknown = [key for key in fields if key not in ("file", "with")]
    if not isinstance(name, str) or not name or unknown:
        text = f"found {show_value(node.value)}; write a file, or {{file: pair.fragment.yaml, with: {{row: 3}}}}"
        raise YamlError([YamlProblem(node.line, place, text, scope.file)])
    values = _read_values(fields.get("with"), (*place, "with"), scope.file)
    return _Inclusion(node, scope, place, chain[-1].parent / name, values, chain)


def _read_values(node: YamlNode | None, place: Place, file: str) -> Variables:
    """A mapping of variables; none without a node. Raises `YamlError`."""
    if node is None:
        return {}
    if not isinstance(node.children, dict):
        text = f"found {show_value(node.value)}; must be a mapping of variables, e.g. {{row: 3}}"
        raise YamlError([YamlProblem(node.line, place, text, file)])
    return dict(_list_values(node.children, place, file))


def _list_values(fields: Mapping[str, YamlNode], place: Place, file: str) -> Iterator[tuple[str, Variable]]:
    for name, child in fields.items():
        variable = make_variable(child)
        if variable is None or not is_variable_name(name):
            text = f"found {show_value(child.value)}; a variable has a name of a-z, 0-9 and _, and one number or text"
            raise YamlError([YamlProblem(child.line, (*place, name), text, file)])
        yield name, variable


def _check_fragment(root: YamlNode, path: Path) -> None:
    """Raises `YamlError` for a file that is no fragment, or has other sections than a fragment may have."""
    schema = root.find_child(SCHEMA) if isinstance(root.children, dict) else None
    if schema is None or schema.value != FRAGMENT_SCHEMA:
        line = root.line if schema is None else schema.line
        text = f"a fragment is a mapping that starts with `schema: {FRAGMENT_SCHEMA}`"
        raise YamlError([YamlProblem(line, (SCHEMA,), text, str(path))])
    wrong_fields = {key: child for key, child in root.entries() if key not in (*SECTIONS, SCHEMA, INCLUDE, DEFAULTS)}
    text = f"a fragment may have: {', '.join(SECTIONS)}, {DEFAULTS}, {INCLUDE}; write others into the fleet file"
    problems = [YamlProblem(child.line, (key,), text, str(path)) for key, child in wrong_fields.items()]
    if problems:
        raise YamlError(problems)
