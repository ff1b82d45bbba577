"""`count` and `each`: the sets of values, one for each member of an entry that is written once for many."""

import itertools
import math
import re
from collections.abc import Iterator, Mapping

from orchestrator.model.errors import TuttiError
from orchestrator.model.expansion.variables import Variable, Variables, is_variable_name, make_variable
from orchestrator.model.explain import show_value
from orchestrator.model.files.yaml_reader import YamlNode

COUNT, EACH, ITEM = "count", "each", "item"
MAX_MEMBERS = 5_000  # of one entry
_RANGE = re.compile(r"(-?[0-9]{1,9})\.\.(-?[0-9]{1,9})")
_REMEDY = "write e.g. `each: {row: 1..5, n: 1..50}`, `each: {side: [left, right]}` or `each: [{n: 1, host: lab-a}]`"


class MemberError(TuttiError, ValueError):
    """Members that cannot be counted. key: the field, `count` or `each`."""

    def __init__(self, key: str, text: str) -> None:
        super().__init__(text)
        self.key = key


def list_members(fields: Mapping[str, YamlNode]) -> list[Variables]:
    """The variables of each member by `count` or `each`. Raises `MemberError`."""
    if COUNT in fields and EACH in fields:
        raise MemberError(COUNT, "`count: 5` is `each: {n: 1..5}`; leave one of the two out")
    if COUNT in fields:
        return [{"n": Variable(n, str(n))} for n in range(1, _read_count(fields[COUNT]) + 1)]
    node = fields[EACH]
    if isinstance(node.children, list):
        members = [_read_member(child) for child in node.children]
        if any(member.keys() != members[0].keys() for member in members):
            raise MemberError(EACH, "each entry must have the same variables")
    else:
        members = _combine_values(node)
    _require_number(EACH, len(members))
    return members


def _read_count(node: YamlNode) -> int:
    if type(node.value) is not int:
        raise MemberError(COUNT, f"found {show_value(node.value)}; must be a whole number")
    _require_number(COUNT, node.value)
    return node.value


def _require_number(key: str, number: int) -> None:
    if not 1 <= number <= MAX_MEMBERS:
        raise MemberError(key, f"makes {number} members; 1 to {MAX_MEMBERS} are allowed")


def _read_member(node: YamlNode) -> Variables:
    """One entry of the list form: a mapping of variables."""
    variables: dict[str, Variable] = {}
    for name, child in _read_names(node):
        variable = make_variable(child)
        if variable is None:
            raise MemberError(EACH, f"{name}: found {show_value(child.value)}; must be one number or text")
        variables[name] = variable
    return variables


def _combine_values(node: YamlNode) -> list[Variables]:
    """All combinations of the values of the mapping form; the last variable changes first."""
    values = {name: _read_values(name, child) for name, child in _read_names(node)}
    _require_number(EACH, math.prod(map(len, values.values())))
    return [dict(zip(values, combination, strict=True)) for combination in itertools.product(*values.values())]


def _read_names(node: YamlNode) -> Iterator[tuple[str, YamlNode]]:
    if not isinstance(node.children, dict) or not node.children:
        raise MemberError(EACH, f"found {show_value(node.value)}; {_REMEDY}")
    for name, child in node.children.items():
        if not is_variable_name(name):
            raise MemberError(EACH, f"{name!r} is no name of a variable: a letter a-z, then a-z, 0-9 and _")
        yield name, child


def _read_values(name: str, node: YamlNode) -> list[Variable]:
    """The values of one variable: a range, or a list."""
    limits = _RANGE.fullmatch(node.text)
    if limits is not None:
        first, last = int(limits[1]), int(limits[2])
        _require_number(EACH, last - first + 1)
        return [Variable(number, str(number)) for number in range(first, last + 1)]
    children = node.children if isinstance(node.children, list) else []
    values = [variable for child in children if (variable := make_variable(child)) is not None]
    if not values or len(values) < len(children):
        raise MemberError(EACH, f"{name}: found {show_value(node.value)}; {_REMEDY}")
    return values
