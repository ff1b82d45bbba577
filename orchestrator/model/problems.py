"""Validation that reports every mistake at once, each with its own place."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import ValidationError
from pydantic_core import InitErrorDetails

T = TypeVar("T")

MAX_DESCRIBED = 1_000
"""Mistakes that are described. pydantic describes all of them or none, at some 2 µs and 1 kB each: 300,000 unknown
fields took a second and 375 MB."""

SUMMARY_REMEDY = "correct those of one kind first"


@dataclass(frozen=True, slots=True)
class Problem:
    """A mistake. place: keys and indices below the model that is validated. found: the value there."""

    place: tuple[str | int, ...]
    text: str
    found: Any = None

    @property
    def is_summary(self) -> bool:
        """Whether it stands for more mistakes than are described."""
        return not self.place and self.text.endswith(SUMMARY_REMEDY)

    @property
    def field(self) -> str:
        """Its place in one word; empty for a mistake of the whole."""
        return ".".join(map(str, self.place))

    def describe(self, whole: str | None = None) -> str:
        """Place and text in one line. whole: the place of a mistake of the whole; None: then the text stands alone."""
        field = self.field or whole
        return self.text if field is None else f"{field}: {self.text}"


def counts_too_many(error: ValidationError) -> bool:
    """Whether there are more mistakes than are described."""
    return error.error_count() > MAX_DESCRIBED


def summarise_problems(error: ValidationError) -> Problem:
    """What is said of more mistakes than are described."""
    text = f"has {error.error_count()} mistakes, of which at most {MAX_DESCRIBED} are listed"
    return Problem((), f"{text}; {SUMMARY_REMEDY}")


def read_problems(error: ValidationError) -> list[Problem]:
    """The mistakes in the words of pydantic; `list_problems` has them in those of a file. Of very many only their
    number."""
    if counts_too_many(error):
        return [summarise_problems(error)]
    return [
        Problem(details["loc"], details["msg"], details["input"])
        for details in error.errors(include_url=False, include_context=False)
    ]


def first_error_text(error: ValidationError) -> str:
    """The first mistake in words, without its place: for a message of one line."""
    return read_problems(error)[0].text


def describe_first_error(error: ValidationError, whole: str | None = None) -> str:
    """The first mistake with its place: for a message of one line. whole: see `Problem.describe`."""
    return read_problems(error)[0].describe(whole)


def validate_with(problems: Sequence[Problem], title: str, validate: Callable[[], T]) -> T:
    """Run pydantic's `validate`; raises its `ValidationError` with `problems` among the errors. title: of the model."""
    errors: list[InitErrorDetails] = []
    result: T | None = None
    try:
        result = validate()
    except ValidationError as error:
        if counts_too_many(error):
            errors = [_make_error(summarise_problems(error))]
        else:
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
