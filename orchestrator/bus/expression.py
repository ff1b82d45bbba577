"""Keys and key expressions, with Zenoh's meaning.

A key is one or more chunks separated by `/`. In an expression `*` stands for one chunk and `**` for any number of
chunks, including none. Zenoh's `$*` (part of a chunk) is not supported.
"""

from functools import lru_cache

from orchestrator.bus.base import Priority

_FORBIDDEN = frozenset("?#$ \t\r\n")


def check_key(key: str) -> str:
    """Return `key`. Raises `ValueError` if it is not a concrete key."""
    if is_wild(check_expression(key)):
        raise ValueError(f"{key!r} is an expression, but a key without '*' is needed")
    return key


def check_put(key: str, priority: Priority) -> str:
    """Return the key of a sample; for an e-stop an expression is allowed, too. Raises `ValueError`."""
    return check_expression(key) if priority is Priority.ESTOP else check_key(key)


@lru_cache(maxsize=4096)
def check_expression(expression: str) -> str:
    """Return `expression`. Raises `ValueError` if it is malformed."""
    for chunk in expression.split("/"):
        if not chunk:
            raise ValueError(f"{expression!r} has an empty chunk")
        if "*" in chunk and chunk not in ("*", "**"):
            raise ValueError(f"{expression!r}: '*' and '**' must be whole chunks, {chunk!r} is not")
        if not _FORBIDDEN.isdisjoint(chunk):
            raise ValueError(f"{expression!r}: '?', '#', '$' and white space are not allowed in a key")
    return expression


def is_wild(expression: str) -> bool:
    """Whether `expression` stands for more than one key."""
    return "*" in expression


def is_silent_on(served: str, requested: str) -> bool:
    """Whether the server of an expression leaves a request on another expression unanswered.

    A request on a wildcard reads the values below it. Whatever serves an expression executes commands, which need a
    concrete key.
    """
    return is_wild(requested) and is_wild(served)


@lru_cache(maxsize=65536)
def expressions_intersect(one: str, other: str) -> bool:
    """Whether a key exists that matches both expressions."""
    if not is_wild(one) and not is_wild(other):
        return one == other
    return _chunks_intersect(one.split("/"), other.split("/"))


def _chunks_intersect(one: list[str], other: list[str]) -> bool:
    if not one or not other:
        return all(chunk == "**" for chunk in one or other)
    if one[0] == "**":
        return _chunks_intersect(one[1:], other) or _chunks_intersect(one, other[1:])
    if other[0] == "**":
        return _chunks_intersect(one, other[1:]) or _chunks_intersect(one[1:], other)
    return (one[0] == other[0] or "*" in (one[0], other[0])) and _chunks_intersect(one[1:], other[1:])
