"""The parameters that a job file declares: their types, bounds and defaults, and how a value is read."""

import re
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import isfinite
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from orchestrator.model.base import Model
from orchestrator.model.explain import show_value
from orchestrator.model.numbers import MAX_NUMBER, parse_duration, split_number, suggest_flag, suggest_number
from orchestrator.model.problems import Problem, raise_problems
from orchestrator.model.units import Quantity, Unit, check_quantity, format_quantity, parse_quantity

PARAMETER_NAME = r"[a-z][a-z0-9_]{0,39}"
MAX_PARAMETERS = 100
MAX_VALUE_LENGTH = 120  # characters of a value
MAX_CHOICES = 100


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """A value of a parameter. plain: as it stands in the job. text: inside other text, and in reports."""

    plain: int | float | bool | str
    text: str


class ParameterBase(Model):
    """What all parameters have."""

    description: str = Field(default="", max_length=300, description="What it is for; a form shows it.")

    @abstractmethod
    def read_value(self, given: object) -> ParameterValue:
        """Read a value as a file gives it. Raises `ValueError` with what is found and what is allowed."""

    def negate_value(self, value: ParameterValue) -> ParameterValue:
        """The value of `-${name}`. Raises `ValueError` where a minus has no meaning."""
        raise ValueError("only a quantity, a number or an integer can have a minus")

    def list_extremes(self) -> Iterator[tuple[str, Any]]:
        """The values at the ends of its range, each with what it is in words."""
        yield from ()


class RangedParameter(ParameterBase):
    """A parameter whose values have an order; `min` and `max` belong to the range."""

    @abstractmethod
    def measure_value(self, given: object) -> Fraction:
        """The size of a value, to compare it. Raises `ValueError` for what is no value of the type."""

    @abstractmethod
    def form_value(self, given: Any) -> ParameterValue:
        """A value that has been measured, as it stands in the job."""

    def read_value(self, given: object) -> ParameterValue:
        size, bounds = self.measure_value(given), self._bounds()
        for name, words, sign in (("min", "at least", 1), ("max", "at most", -1)):
            bound = bounds.get(name)
            if bound is not None and sign * size < sign * self.measure_value(bound):
                raise ValueError(f"found {show_value(given)}; must be {words} {self.form_value(bound).text}")
        return self.form_value(given)

    def list_extremes(self) -> Iterator[tuple[str, Any]]:
        for name, bound in self._bounds().items():
            if bound is not None:
                yield f"its {name}", bound

    @model_validator(mode="after")
    def _check_bounds(self) -> "RangedParameter":
        """The range is not empty, and the default is in it; each mistake at its own field."""
        sizes: dict[str, Fraction] = {}
        problems: list[Problem] = []
        for name, value in self._bounds().items():
            try:
                sizes |= {} if value is None else {name: self.measure_value(value)}
            except ValueError as error:
                problems.append(Problem((name,), str(error), value))
        if "min" in sizes and "max" in sizes and sizes["min"] > sizes["max"]:
            problems.append(Problem(("min",), "min is above max; swap them", self._bounds()["min"]))
        default = getattr(self, "default", None)
        if default is not None and not problems:
            try:
                self.read_value(default)
            except ValueError as error:
                problems.append(Problem(("default",), f"the default is not allowed: {error}", default))
        raise_problems(problems, type(self).__name__)
        return self

    def _bounds(self) -> dict[str, Any]:
        return {"min": getattr(self, "min", None), "max": getattr(self, "max", None)}


class QuantityParameter(RangedParameter):
    """A position or a distance. A number without a unit is in `unit`."""

    type: Literal["quantity"]
    unit: Unit
    default: Quantity | None = None
    min: Quantity | None = None
    max: Quantity | None = None

    def measure_value(self, given: object) -> Fraction:
        quantity = check_quantity(given)
        assert isinstance(quantity, int | float | str)
        return parse_quantity(quantity, self.unit, "the parameter")

    def form_value(self, given: Any) -> ParameterValue:
        text = format_quantity(given, self.unit)
        return ParameterValue(text, text)

    def negate_value(self, value: ParameterValue) -> ParameterValue:
        text = value.text.removeprefix("+")
        text = text[1:] if text.startswith("-") else f"-{text}"
        return ParameterValue(text, text)


class NumberParameter(RangedParameter):
    """A plain number."""

    type: Literal["number"]
    default: float | None = None
    min: float | None = None
    max: float | None = None

    def measure_value(self, given: object) -> Fraction:
        return _measure_number(given, "a number")

    def form_value(self, given: Any) -> ParameterValue:
        return _form_number(given)

    def negate_value(self, value: ParameterValue) -> ParameterValue:
        return _form_number(-value.plain)  # type: ignore[operator]


class IntegerParameter(RangedParameter):
    """A whole number."""

    type: Literal["integer"]
    default: int | None = None
    min: int | None = None
    max: int | None = None

    def measure_value(self, given: object) -> Fraction:
        if isinstance(given, float):
            raise ValueError(f"found {show_value(given)}; must be a whole number")
        return _measure_number(given, "a whole number")

    def form_value(self, given: Any) -> ParameterValue:
        return _form_number(given)

    def negate_value(self, value: ParameterValue) -> ParameterValue:
        return _form_number(-value.plain)  # type: ignore[operator]


def _check_part_text(value: object) -> object:
    if value is not None:
        _measure_part(value)
    return value


PartText = Annotated[
    float | str,
    BeforeValidator(_check_part_text),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "pattern": r"%\s*$"}]}),
]


class PartParameter(RangedParameter):
    """A fraction, above 0 to 1, such as a speed; also with a percent sign, "50%"."""

    type: Literal["part"]
    default: PartText | None = None
    min: PartText | None = None
    max: PartText | None = None

    def measure_value(self, given: object) -> Fraction:
        return _measure_part(given)

    def form_value(self, given: Any) -> ParameterValue:
        return _form_number(float(_measure_part(given)))


def _check_duration_text(value: object) -> object:
    if value is not None:
        parse_duration(value)
    return value


DurationText = Annotated[str, BeforeValidator(_check_duration_text)]


class DurationParameter(RangedParameter):
    """A span of time with its unit, such as "10 ms"."""

    type: Literal["duration"]
    default: DurationText | None = None
    min: DurationText | None = None
    max: DurationText | None = None

    def measure_value(self, given: object) -> Fraction:
        return Fraction(parse_duration(given))

    def form_value(self, given: Any) -> ParameterValue:
        return ParameterValue(given, given.strip())


Choice = Annotated[str, Field(min_length=1, max_length=MAX_VALUE_LENGTH)]


class TextParameter(ParameterBase):
    """Text: a name, a label, the name of an output or of a position."""

    type: Literal["text"]
    default: Choice | None = None
    choices: list[Choice] = Field(
        default=[], max_length=MAX_CHOICES, description="The values that are allowed; none: any text."
    )

    def read_value(self, given: object) -> ParameterValue:
        if not isinstance(given, str):
            needs_quotes = isinstance(given, int | float) and not isinstance(given, bool)
            hint = f'; write it in quotes: "{given}"' if needs_quotes else ""
            raise ValueError(f"found {show_value(given)}; must be text{hint}")
        if not given or len(given) > MAX_VALUE_LENGTH:
            raise ValueError(f"has {len(given)} characters; must have 1 to {MAX_VALUE_LENGTH}")
        if self.choices and given not in self.choices:
            raise ValueError(f"found {show_value(given)}; allowed: {', '.join(self.choices)}")
        return ParameterValue(given, given)

    def list_extremes(self) -> Iterator[tuple[str, Any]]:
        for choice in self.choices:
            yield "one of its choices", choice

    @model_validator(mode="after")
    def _check_choices(self) -> "TextParameter":
        choices_twice = sorted({choice for choice in self.choices if self.choices.count(choice) > 1})
        problems = [Problem(("choices",), f"{choices_twice[0]} is listed twice; list it once")] if choices_twice else []
        if self.default is not None and self.choices and self.default not in self.choices:
            text = f"the default is not allowed: found {self.default!r}; allowed: {', '.join(self.choices)}"
            problems.append(Problem(("default",), text, self.default))
        raise_problems(problems, type(self).__name__)
        return self


class BooleanParameter(ParameterBase):
    """True or false, such as the state of an output."""

    type: Literal["boolean"]
    default: bool | None = None

    def read_value(self, given: object) -> ParameterValue:
        if not isinstance(given, bool):
            hint = suggest_flag(given) if isinstance(given, str) else "must be true or false"
            raise ValueError(f"found {show_value(given)}; {hint}")
        return ParameterValue(given, "true" if given else "false")

    def list_extremes(self) -> Iterator[tuple[str, Any]]:
        yield from (("", True), ("", False))


Parameter = Annotated[
    QuantityParameter
    | NumberParameter
    | IntegerParameter
    | PartParameter
    | DurationParameter
    | TextParameter
    | BooleanParameter,
    Field(discriminator="type"),
]


def _check_name(name: object) -> object:
    if isinstance(name, str) and re.fullmatch(PARAMETER_NAME, name) is None:
        raise ValueError(
            f"{show_value(name)} is no name of a parameter; write a-z, 0-9 and _, first a letter, at most 40 characters"
        )
    return name


ParameterName = Annotated[str, BeforeValidator(_check_name)]


class ParameterDeclarations(Model):
    """The part of a job file that declares its parameters; each has the fields of its type.

    `${name}` stands for its value in all other fields of the file: see `docs/how-to/use-templates.md`.
    """

    parameters: dict[ParameterName, Parameter] = Field(
        default={},
        max_length=MAX_PARAMETERS,
        description="Values that are given when the job is submitted; `${name}` stands for them in its fields.",
    )


def _measure_number(given: object, kind: str) -> Fraction:
    if isinstance(given, bool) or not isinstance(given, int | float):
        hint = suggest_number(given) if isinstance(given, str) else ""
        raise ValueError(f"found {show_value(given)}; must be {kind}{f'; {hint}' if hint else ''}")
    if not isfinite(given) or abs(given) > MAX_NUMBER:
        raise ValueError(f"found {show_value(given)}; the largest number is {MAX_NUMBER:g}")
    return Fraction(str(given))


def _measure_part(given: object) -> Fraction:
    parts = split_number(given) if isinstance(given, str) else None
    if parts is not None and parts[1] == "%":
        size = Fraction(parts[0]) / 100
    else:
        size = _measure_number(given, 'a fraction such as 0.5 or "50%"')
    if not 0 < size <= 1:
        raise ValueError(f"found {show_value(given)}; must be above 0 and at most 1 (100%)")
    return size


def _form_number(number: Any) -> ParameterValue:
    return ParameterValue(number, str(number))


def describe_parameter(parameter: Parameter) -> dict[str, Any]:
    """A parameter for programs; every field is there, null where its type has none."""
    fields = dict.fromkeys(("type", "unit", "default", "min", "max", "choices"))
    plain = {**fields, **parameter.to_plain()}
    return {**plain, "choices": plain["choices"] or None, "required": plain["default"] is None}
