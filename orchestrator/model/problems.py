"""Validation that reports every mistake at once, each with its own place."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import ValidationError
from pydantic_core import InitErrorDetails

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Problem:
    """A mistake. place: keys and indices below the model that is validated. found: the value there."""

    place: tuple[str | int, ...]
    text: str
    found: Any = None


def first_error_text(error: ValidationError) -> str:
    """The first mistake in words, without its place: for a message of one line."""
    return str(error.errors(include_url=False)[0]["msg"])


def validate_with(problems: Sequence[Problem], title: str, validate: Callable[[], T]) -> T:
    """Run pydantic's `validate`; raises its `ValidationError` with `problems` among the errors. title: of the model."""
    errors: list[InitErrorDetails] = []
    result: T | None = None
    try:
        result = validate()
    except ValidationError as error:
        errors = [_carry_over(dict(details)) for details in error.errors(include_url=False)]
    errors += [_make_error(problem) for problem in problems]
    if errors:
        raise ValidationError.from_exception_data(title, errors)
    assert result is not None
    return result


def raise_problems(problems: Sequence[Problem], title: str) -> None:
    """Raise `ValidationError` with all of `problems`, if there are any."""
    if problems:
        raise ValidationError.from_exception_data(title, [_make_error(problem) for problem in problems])


def _make_error(problem: Problem) -> InitErrorDetails:
    return InitErrorDetails(
        type="value_error", loc=problem.place, input=problem.found, ctx={"error": ValueError(problem.text)}
    )


def _carry_over(error: dict[str, Any]) -> InitErrorDetails:
    return InitErrorDetails(type=error["type"], loc=error["loc"], input=error["input"], ctx=error.get("ctx", {}))
