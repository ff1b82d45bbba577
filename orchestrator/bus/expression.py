"""Keys and key expressions, with the meaning Zenoh gives them.

A key is one or more chunks with `/` between. In an expression `*` stands for one chunk and `**` for any number of
them, none included. Zenoh's `$*` (part of a chunk) is left out: nothing here needs it.
"""

from functools import lru_cache

from orchestrator.bus.base import Priority

_FORBIDDEN = frozenset("?#$ \t\r\n")


def check_key(key: str) -> str:
    """Give `key` back. Raises `ValueError` when it is not a concrete key."""
    if is_wild(check_expression(key)):
        raise ValueError(f"{key!r} is an expression where a key without '*' is needed")
    return key


def check_put(key: str, priority: Priority) -> str:
    """Give back what a sample is put on: a key; of an e-stop, an expression too. Raises `ValueError`."""
    return check_expression(key) if priority is Priority.ESTOP else check_key(key)


@lru_cache(maxsize=4096)
def check_expression(expression: str) -> str:
    """Give `expression` back. Raises `ValueError` when it is malformed."""
    for chunk in expression.split("/"):
        if not chunk:
            raise ValueError(f"{expression!r} has an empty chunk")
        if "*" in chunk and chunk not in ("*", "**"):
            raise ValueError(f"{expression!r}: '*' and '**' must be whole chunks, {chunk!r} is not")
        if not _FORBIDDEN.isdisjoint(chunk):
            raise ValueError(f"{expression!r}: none of '?', '#', '$' and white space may stand in a key")
    return expression


def is_wild(expression: str) -> bool:
    """Whether `expression` stands for more than one key."""
    return "*" in expression


@lru_cache(maxsize=65536)
def intersects(one: str, other: str) -> bool:
    """Whether there is a key that both expressions stand for."""
    if not is_wild(one) and not is_wild(other):
        return one == other
    return _meet(one.split("/"), other.split("/"))


def _meet(one: list[str], other: list[str]) -> bool:
    if not one or not other:
        return all(chunk == "**" for chunk in one or other)
    if one[0] == "**":
        return _meet(one[1:], other) or _meet(one, other[1:])
    if other[0] == "**":
        return _meet(one, other[1:]) or _meet(one[1:], other)
    return (one[0] == other[0] or "*" in (one[0], other[0])) and _meet(one[1:], other[1:])
