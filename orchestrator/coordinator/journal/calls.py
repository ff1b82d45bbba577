"""A call of the journal, with its result or its error."""

from collections.abc import Callable
from functools import partial
from typing import Any

from orchestrator.coordinator.journal.records import JournalError


class JournalCall:
    """A call that is run once. name: of its function. table: the part of the journal that has the function; None: none.
    on_error: of a call that nothing waits for: called with an error of the journal."""

    __slots__ = ("_function", "_value", "error", "is_done", "name", "on_error", "table")

    def __init__(
        self,
        function: Callable[..., object],
        values: tuple[Any, ...],
        on_error: Callable[[JournalError], None] | None = None,
    ) -> None:
        self._function = partial(function, *values)
        self._value: object = None
        self.name = function.__name__
        self.table: object = getattr(function, "__self__", None)
        self.on_error = on_error
        self.error: Exception | None = None
        self.is_done = False

    def run(self) -> None:
        """Run it, unless it has been. Raises nothing."""
        if not self.is_done:
            self.attempt()
            self.is_done = True

    def attempt(self) -> None:
        """Run it as a part of a transaction, which may be rolled back: it is not done yet."""
        self._value = self.error = None
        try:
            self._value = self._function()
        except Exception as error:
            self.error = error

    def fail(self, error: Exception) -> None:
        """It ends with `error`, unless it has ended."""
        if not self.is_done:
            self.error, self.is_done = error, True

    def take_result(self) -> Any:
        """What the function has returned; raises what it has raised."""
        if self.error is not None:
            raise self.error
        return self._value
