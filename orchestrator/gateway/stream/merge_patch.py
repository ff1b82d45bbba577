"""Differences of JSON objects as merge patches (RFC 7386): null deletes, objects are merged, all else is replaced."""

from collections.abc import Mapping
from typing import Any, cast

Plain = Mapping[str, Any]


def make_patch(before: Plain, after: Plain) -> dict[str, Any]:
    """The patch that makes `after` of `before`; empty if they are equal. Neither may contain null."""
    patch: dict[str, Any] = {}
    for key, value in after.items():
        old = before.get(key)
        if old is value or old == value:
            continue
        if isinstance(old, dict) and isinstance(value, dict):
            patch[key] = make_patch(cast(Plain, old), cast(Plain, value))
        else:
            patch[key] = value
    for key in before:
        if key not in after:
            patch[key] = None
    return patch


def apply_patch(before: Plain, patch: Plain) -> dict[str, Any]:
    """What a reader makes of a patch."""
    state = dict(before)
    for key, value in patch.items():
        if value is None:
            state.pop(key, None)
        elif isinstance(value, dict):
            old = state.get(key)
            state[key] = apply_patch(cast(Plain, old) if isinstance(old, dict) else {}, cast(Plain, value))
        else:
            state[key] = value
    return state


def drop_nulls(value: Plain) -> dict[str, Any]:
    """A JSON object without its nulls, in objects inside as well: a merge patch cannot express them."""
    return {
        key: drop_nulls(cast(Plain, item)) if isinstance(item, dict) else item
        for key, item in value.items()
        if item is not None
    }
