"""The repair of a fault."""

from collections.abc import Callable

Repair = Callable[[], object]


def do_nothing() -> None:
    """Repair a fault that repairs itself, or has no duration."""
    return None
