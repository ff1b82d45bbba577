"""Patterns of names: a name, or a part of it with `*` for any signs."""

import re
from collections.abc import Iterable
from fnmatch import translate

MAX_PATTERN = 140
_PATTERN = re.compile(r"[a-z0-9*][a-z0-9*._-]*")


def check_pattern(text: str) -> str:
    """`text`, if it is a pattern of names. Raises ValueError, with the remedy."""
    if len(text) > MAX_PATTERN or _PATTERN.fullmatch(text) is None:
        raise ValueError(f"{text[:40]!r} is no name; write a name, or a part of it with *, for example hall-1*")
    return text


def select_names(patterns: Iterable[str], names: Iterable[str]) -> list[str]:
    """The names that fit one of `patterns`, in the order of `names`.

    A pattern without `*` is looked up, so that many of them cost no more than few. Those with `*` are compared without
    backtracking, however they are written."""
    patterns = list(patterns)
    plain_names = {pattern for pattern in patterns if "*" not in pattern}
    expressions = [translate(pattern) for pattern in patterns if "*" in pattern]
    if not expressions:
        return [name for name in names if name in plain_names]
    expression = re.compile("|".join(expressions))
    return [name for name in names if name in plain_names or expression.match(name) is not None]
