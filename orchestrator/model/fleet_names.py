"""References inside a fleet file, checked by the names that the file has.

They are checked in the data as it was read, so that a mistake in one axis does not hide the wrong names elsewhere.
"""

import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from orchestrator.model.base import Model
from orchestrator.model.names import is_position_name, split_name
from orchestrator.model.numbers import name_odd_sign
from orchestrator.model.problems import Problem
from orchestrator.model.virtual_axes import list_axes

Place = tuple[str | int, ...]
EACH = "*"
MAX_LISTED = 20  # names in one message
WHOLE_FLEET = "all"  # on the command line: no group or controller can have this name


@dataclass(frozen=True, slots=True)
class DefinedNames:
    """All names that a fleet file defines, as `controller.name` but for controllers and groups."""

    controllers: list[str] = field(default_factory=list[str])
    groups: list[str] = field(default_factory=list[str])
    axes: list[str] = field(default_factory=list[str])
    inputs: list[str] = field(default_factory=list[str])
    outputs: list[str] = field(default_factory=list[str])
    positions: list[str] = field(default_factory=list[str])
    frames: list[str] = field(default_factory=list[str])
    virtual_groups: list[str] = field(default_factory=list[str])
    virtual: list[str] = field(default_factory=list[str])
    _sets: dict[str, frozenset[str]] = field(default_factory=dict[str, frozenset[str]], compare=False, repr=False)

    def _find_set(self, kind: str) -> frozenset[str]:
        """The names of a kind; made once, because a step of a large fleet has thousands."""
        names = self._sets.get(kind)
        if names is None:
            names = self._sets[kind] = frozenset(self._list_known(kind))
        return names

    def _list_known(self, kind: str) -> list[str]:
        match kind:
            case "axis":
                return self.axes
            case "target":
                return [*self.axes, *self.virtual]
            case "input":
                return self.inputs
            case "output":
                return self.outputs
            case _:
                return [*self.axes, *self.groups, *self.controllers, *self.virtual_groups, *self.virtual]

    def explain_unknown(self, name: object, kind: str) -> str | None:
        """Why `name` is no name of that kind: axis (a real one), target (also a virtual one), axes (also groups and
        controllers), input or output; or None."""
        if not isinstance(name, str) or name in self._find_set(kind):
            return None  # another type is reported by the field itself
        known_names = self._list_known(kind)
        if name in self.virtual:
            return f"{name} is a virtual axis, which moves only; name one of its real axes here"
        noun = {"axes": "axis, group or controller", "target": "axis"}.get(kind, kind)
        if (odd_sign := name_odd_sign(name)) != "":
            return f"the fleet has no {noun} {name[:80]!r}; {odd_sign}"
        listed_axes = [*self.axes, *self.virtual] if kind == "axes" else known_names
        return f"the fleet has no {noun} {name[:80]}; {suggest_name(name, known_names)}{list_names(listed_axes, kind)}"


def suggest_name(name: str, known: Iterable[str]) -> str:
    """The nearest of the known names, as the beginning of a remedy; empty if none is near."""
    matches = difflib.get_close_matches(name[:80], list(known), 1, 0.75)
    return f"did you mean {matches[0]}? " if matches else ""


def list_names(names: list[str], kind: str) -> str:
    """`its axes are: …`, with at most `MAX_LISTED` names."""
    plural = "axes" if kind in ("axis", "axes", "target") else f"{kind}s"
    listing = ", ".join(names[:MAX_LISTED]) + (f", … ({len(names)} in all)" if len(names) > MAX_LISTED else "")
    return f"its {plural} are: {listing}" if names else f"it has no {plural}"


def find_reference_problems(data: Any) -> list[Problem]:
    """Every reference in a fleet file that leads nowhere, or to something that is used already."""
    if not isinstance(data, Mapping):
        return []
    plain = {str(key): _make_plain(value) for key, value in cast(Mapping[str, Any], data).items()}
    names = collect_names(plain)
    return [
        *_find_unknown(plain, names),
        *_find_group_problems(names),
        *_find_position_problems(plain, names),
        *_find_double_use(plain),
        *_find_homing_circles(plain),
    ]


def collect_names(plain: Mapping[str, Any]) -> DefinedNames:
    """The names of a fleet file."""
    names = DefinedNames()
    for (_, controller), _ in select(plain, "controllers", EACH):
        names.controllers.append(str(controller))
    for kind, collection in (("axes", names.axes), ("inputs", names.inputs), ("outputs", names.outputs)):
        collection += [f"{path[1]}.{path[3]}" for path, _ in select(plain, "controllers", EACH, kind, EACH)]
    for (_, group), axes in select(plain, "virtual", EACH):
        names.virtual_groups.append(str(group))
        names.virtual.extend(f"{group}.{axis}" for axis in list_axes(axes))
    names.frames.extend(str(path[1]) for path, _ in select(plain, "frames", EACH))
    names.groups.extend(str(path[1]) for path, _ in select(plain, "groups", EACH))
    names.positions.extend(str(path[1]) for path, _ in select(plain, "positions", EACH))
    return names


def select(data: Any, *pattern: str) -> Iterator[tuple[Place, Any]]:
    """All values at `pattern`, with their places; `*` stands for every key or index. What is not there is left out."""
    if not pattern:
        yield (), data
        return
    entries: Iterable[tuple[str | int, Any]] = ()
    if isinstance(data, Mapping):
        mapping = cast(Mapping[str, Any], data)
        entries = mapping.items() if pattern[0] == EACH else [(k, mapping[k]) for k in pattern[:1] if k in mapping]
    elif isinstance(data, list | tuple) and pattern[0] == EACH:
        entries = enumerate(cast(list[Any], data))
    for key, value in entries:
        for path, value_found in select(value, *pattern[1:]):
            yield (key, *path), value_found


_REFERENCES: tuple[tuple[tuple[str, ...], str], ...] = (
    (("groups", EACH, EACH), "axis"),
    (("frames", EACH, "axes", EACH), "axis"),
    (("virtual", EACH, "of", EACH), "target"),
    (("home_order", EACH), "axes"),
    (("controllers", EACH, "axes", EACH, "homing", "after", EACH), "axis"),
    (("permits", EACH, "input"), "input"),
    (("permits", EACH, "axes", EACH), "axes"),
    (("wiring", EACH, "from"), "output"),
    (("wiring", EACH, "to", EACH), "input"),
)


def _find_unknown(plain: Mapping[str, Any], names: DefinedNames) -> Iterator[Problem]:
    for pattern, kind in _REFERENCES:
        for path, name in select(plain, *pattern):
            text = names.explain_unknown(name, kind)
            if text is not None:
                yield Problem(path, text, name)
    for path, output in select(plain, "controllers", EACH, "axes", EACH, "brake", "output"):
        if isinstance(output, str) and f"{path[1]}.{output}" not in names.outputs:
            own = [split_name(name)[1] for name in names.outputs if name.startswith(f"{path[1]}.")]
            output_list = ", ".join(own) or "none"
            yield Problem(path, f"the controller has no output {output}; known outputs: {output_list}", output)


def _find_group_problems(names: DefinedNames) -> Iterator[Problem]:
    for group in names.groups:
        if group in names.controllers:
            yield Problem(("groups", group), f"group {group} has the name of a controller; rename one of them")
    for group in names.virtual_groups:
        owners = (("controller", names.controllers), ("group", names.groups), ("frame", names.frames))
        for noun, known_names in owners:
            if group in known_names:
                text = f"the virtual axes {group} have the name of a {noun}; rename one of them"
                yield Problem(("virtual", group), text)
    kinds = (("groups", names.groups), ("controllers", names.controllers), ("virtual", names.virtual_groups))
    for kind, known_names in kinds:
        if WHOLE_FLEET in known_names:
            text = (
                f"`{WHOLE_FLEET}` stands for the whole fleet (`tutti axis disable {WHOLE_FLEET}`); choose another name"
            )
            yield Problem((kind, WHOLE_FLEET), text)


def _find_position_problems(plain: Mapping[str, Any], names: DefinedNames) -> Iterator[Problem]:
    for name in names.positions:
        text = explain_position_name(name, names)
        if text is not None:
            yield Problem(("positions", name), text, name)
    for path, value in (*select(plain, "positions", EACH, EACH), *select(plain, "positions", EACH, "axes", EACH)):
        axis = str(path[-1])
        # Without a dot it is a field, which reports itself; only axes have a dot.
        text = names.explain_unknown(axis, "target") if "." in axis or "axes" in path[2:-1] else None
        if text is not None:
            yield Problem(path, text, value)


def explain_position_name(name: str, names: DefinedNames) -> str | None:
    """Why `name` cannot name a position; None if it can."""
    if not is_position_name(name):
        return (
            f"{name[:80]!r} is no name of a position; write a-z, 0-9, _ and -, first a letter, and no word that reads "
            "as a value"
        )
    for kind, kind_names in (
        ("controller", names.controllers),
        ("group", names.groups),
        ("group of virtual axes", names.virtual_groups),
    ):
        if name in kind_names:
            return f"position {name} has the name of a {kind}; rename the position"
    return None


def _find_double_use(plain: Mapping[str, Any]) -> Iterator[Problem]:
    """Motors, inputs and outputs that have two names or two purposes."""
    for (_, controller), _ in select(plain, "controllers", EACH):
        own = ("controllers", str(controller))
        yield from _find_repeated(
            select(plain, *own, "axes", EACH, "motors", EACH), "motor {0} belongs to axis {1} and to axis {2}", 3
        )
        for kind in ("input", "output"):
            yield from _find_repeated(
                select(plain, *own, f"{kind}s", EACH, "number"), kind + " {0} has two names: {1} and {2}", 3
            )
    sources: dict[str, str] = {}
    for path, end in select(plain, "wiring", EACH, "to", EACH):
        source = next((str(name) for _, name in select(plain["wiring"][path[1]], "from")), "?")
        if isinstance(end, str) and end in sources and sources[end] != source:
            text = f"input {end} is wired to {sources[end]} and to {source}; wire it to one output"
            yield Problem(path, text, end)
        sources.setdefault(str(end), source)
    purposes: dict[str, str] = {}
    brakes = select(plain, "controllers", EACH, "axes", EACH, "brake", "output")
    for path, name, purpose in [
        *((path, f"{path[1]}.{name}", f"the brake of {path[1]}.{path[3]}") for path, name in brakes if name),
        *((path, str(name), "a trigger line") for path, name in select(plain, "wiring", EACH, "from")),
    ]:
        if purposes.get(name, purpose) != purpose:
            yield Problem(path, f"output {name} is {purposes[name]} and {purpose}; use one output for each", name)
        purposes.setdefault(name, purpose)


def _find_repeated(found: Iterable[tuple[Place, Any]], text: str, owner: int) -> Iterator[Problem]:
    """Values that two owners have; `owner`: the index of the owner's name in a place."""
    first: dict[str, str] = {}
    for path, value in found:
        if isinstance(value, str | int) and not isinstance(value, bool):
            key, name = str(value), str(path[owner])
            if first.setdefault(key, name) != name:
                yield Problem(path, text.format(key, first[key], name), value)


def _find_homing_circles(plain: Mapping[str, Any]) -> Iterator[Problem]:
    """Axes that wait for themselves by `homing.after`, directly or through others."""
    predecessors: dict[str, set[str]] = {}
    for path, predecessor in select(plain, "controllers", EACH, "axes", EACH, "homing", "after", EACH):
        predecessors.setdefault(f"{path[1]}.{path[3]}", set()).add(str(predecessor))
    for name in predecessors:
        waits_for, todo = set[str](), list(predecessors[name])
        while todo:
            predecessor = todo.pop()
            if predecessor not in waits_for:
                waits_for.add(predecessor)
                todo += predecessors.get(predecessor, ())
        if name in waits_for:
            controller, axis = name.split(".", 1)
            path = ("controllers", controller, "axes", axis, "homing", "after")
            yield Problem(path, f"axis {name} waits for itself (homing.after); remove one of the entries")


def _make_plain(value: Any) -> Any:
    """Models that a program has built become what a file would have; anything else is as it is."""
    if isinstance(value, Model):
        return value.to_plain()
    if isinstance(value, Mapping):
        return {str(key): _make_plain(item) for key, item in cast(Mapping[str, Any], value).items()}
    if isinstance(value, list | tuple):
        return [_make_plain(item) for item in cast(list[Any], value)]
    return value
