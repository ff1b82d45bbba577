"""Models that people construct in Python, and not only by files and messages."""

import inspect
from types import GenericAlias, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import ValidationError

from orchestrator.model.base import Model
from orchestrator.model.errors import TuttiError
from orchestrator.model.explain import list_problems
from orchestrator.model.problems import Problem


class WrongValue(TuttiError, ValueError):
    """Values of which a step or a job cannot be made; its text names every one. problems: with their places."""

    def __init__(self, model: str, problems: list[Problem]) -> None:
        super().__init__("; ".join(problem.describe(model) for problem in problems))
        self.problems = problems


class _PlainSignature:
    """The signature of a class, made when it is asked for: help texts and editors ask, programs do not."""

    def __init__(self, full: Any) -> None:
        self._full = full

    def __get__(self, instance: object, owner: type) -> inspect.Signature:
        if instance is not None:
            raise AttributeError("__signature__")
        full = self._full.__get__(None, owner) if hasattr(self._full, "__get__") else self._full
        return full.replace(
            parameters=[
                parameter.replace(annotation=_strip_checks(parameter.annotation))
                for parameter in full.parameters.values()
            ]
        )


def _strip_checks(annotation: Any) -> Any:
    """The type without `Annotated`, at every depth."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _strip_checks(arguments[0])
    if origin in (Union, UnionType):
        union = _strip_checks(arguments[0])
        for argument in arguments[1:]:
            union |= _strip_checks(argument)
        return union
    if isinstance(annotation, GenericAlias):
        return GenericAlias(origin, tuple(map(_strip_checks, arguments)))  # pyright: ignore[reportArgumentType]
    return annotation


class ScriptModel(Model):
    """A model whose constructor raises `WrongValue`, and whose signature has types alone, without their checks."""

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise WrongValue(type(self).__name__, list_problems(error, type(self))) from None

    # Validation fills the fields itself, as for a model without a constructor of its own.
    __init__.__pydantic_base_init__ = True  # pyright: ignore[reportFunctionMemberAccess]

    @classmethod
    def __pydantic_on_complete__(cls) -> None:
        cls.__signature__ = _PlainSignature(cls.__dict__.get("__signature__"))  # pyright: ignore[reportAttributeAccessIssue]
