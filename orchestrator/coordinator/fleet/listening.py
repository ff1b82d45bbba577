"""Listeners that only look on: a defect of one is reported, and keeps nothing else from its work."""

from collections.abc import Callable
from typing import ParamSpec

from orchestrator.clock.owner import TaskOwner

P = ParamSpec("P")


def keep_apart(tasks: TaskOwner, listener: Callable[P, None]) -> Callable[P, None]:
    """Return the listener, whose exceptions are reported as defects to the owner of `tasks`."""

    def call_listener(*values: P.args, **names: P.kwargs) -> None:
        try:
            listener(*values, **names)
        except Exception as error:
            tasks.on_defect(error, False)  # noqa: FBT003 - the callback of an owner of tasks

    return call_listener
