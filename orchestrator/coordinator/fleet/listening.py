"""Listeners, and how they are removed; a defect of one that only looks on is reported, and keeps nothing else from its
work."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

from orchestrator.clock.owner import TaskOwner

P = ParamSpec("P")
T = TypeVar("T")

Remove = Callable[[], None]
"""Removes a listener."""


def add_to(listeners: list[T], listener: T) -> Remove:
    """Add a listener; the result removes it."""
    listeners.append(listener)
    return lambda: listeners.remove(listener)


def add_to_each(lists: list[list[T]], listener: T) -> Remove:
    """Add a listener to several lists; the result removes it from all of them."""

    def remove_from_all() -> None:
        for listeners in lists:
            listeners.remove(listener)

    for listeners in lists:
        listeners.append(listener)
    return remove_from_all


def keep_apart(tasks: TaskOwner, listener: Callable[P, None]) -> Callable[P, None]:
    """Return the listener, whose exceptions are reported as defects to the owner of `tasks`."""

    def call_listener(*values: P.args, **names: P.kwargs) -> None:
        try:
            listener(*values, **names)
        except Exception as error:
            tasks.on_defect(error, False)  # noqa: FBT003 - the callback of an owner of tasks

    return call_listener
