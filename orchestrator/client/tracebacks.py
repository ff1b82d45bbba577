"""Errors that end in the code of a user: a traceback shows the call that was refused, not the way of it."""

import inspect
from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any, TypeVar

from orchestrator.model.errors import TuttiError

C = TypeVar("C", bound=type)
R = TypeVar("R")


def end_tracebacks(cls: C) -> C:
    """Let each public coroutine method of a class raise errors of `TuttiError` without the frames below it."""
    for name, function in inspect.getmembers(cls, inspect.iscoroutinefunction):
        if not name.startswith("_"):
            setattr(cls, name, _end_here(function))
    return cls


def _end_here(function: Callable[..., Coroutine[Any, Any, R]]) -> Callable[..., Coroutine[Any, Any, R]]:
    @wraps(function)
    async def call(*arguments: Any, **named: Any) -> R:
        try:
            return await function(*arguments, **named)
        except TuttiError as error:
            raise error.with_traceback(None) from None

    return call
