"""Requests are decoded within their budget, and refused with their first mistake."""

import json
from collections.abc import Mapping
from itertools import islice
from typing import Any, TypeVar, cast

from pydantic import ValidationError
from pydantic_core import from_json

from orchestrator.bus.base import BusSample, RequestRefused
from orchestrator.bus.budgets import WorkBudget, find_request_budget
from orchestrator.model.base import Model
from orchestrator.model.jobs.parts import split_value
from orchestrator.model.problems import Problem, counts_too_many, read_problems

M = TypeVar("M", bound=Model)

MAX_AT_ONCE = 64_000  # bytes that are decoded in a loop; more take so long that heartbeats would be late

MAX_ENTRIES = 20  # of each list and object, in which the first of very many mistakes is looked for
MAX_NODES = 2_000  # of all of them together


def read_request(model: type[M], sample: BusSample, prefix: str, whole: str = "payload") -> M:
    """Decode a request within the budget of its key. prefix: begins the text of a refusal. whole: stands there for the
    place of a mistake of the whole.

    Raises `RequestRefused`, which names what exceeds the budget, or the first mistake with its place.
    """
    budget = find_request_budget(sample.key)
    if budget is not None:
        require_budget(budget, sample.payload, prefix)
    try:
        return model.model_validate_json(sample.payload)
    except ValidationError as error:
        problem = find_first_problem(error, model, sample.payload)
        raise RequestRefused(f"{prefix}{problem.describe(whole)}") from None


def read_request_parts(model: type[M], sample: BusSample, prefix: str, whole: str = "payload") -> list[bytes]:
    """`read_request` in another process, for a large one: the request in parts. Raises `RequestRefused`."""
    return split_value(read_request(model, sample, prefix, whole))


def require_budget(budget: WorkBudget, payload: bytes, prefix: str) -> None:
    """Raises `RequestRefused` for a message that exceeds its budget."""
    excess = budget.find_excess(payload)
    if excess:
        raise RequestRefused(f"{prefix}too large: {excess}")


def find_first_problem(error: ValidationError, model: type[Model], payload: bytes) -> Problem:
    """The first mistake of a message that is not valid. Of very many they are looked for in the beginnings of its lists
    and objects, because pydantic describes all or none."""
    if counts_too_many(error):
        shortened_text = json.dumps(_shorten_value(from_json(payload), [MAX_NODES]))
        try:
            model.model_validate_json(shortened_text)
        except ValidationError as first_error:
            if not counts_too_many(first_error):
                problem = read_problems(first_error)[0]
                text = f"{problem.text} (and {error.error_count() - 1} mistakes more)"
                return Problem(problem.place, text, problem.found)
    return read_problems(error)[0]


def _shorten_value(value: Any, node_counts: list[int]) -> Any:
    """The beginnings of all lists and objects in a decoded value. node_counts: one number, of the nodes that may
    still be taken."""
    node_counts[0] -= 1
    if isinstance(value, dict):
        entries = islice(cast(Mapping[str, Any], value).items(), MAX_ENTRIES if node_counts[0] > 0 else 0)
        return {key: _shorten_value(entry, node_counts) for key, entry in entries}
    if isinstance(value, list):
        items = islice(cast(list[Any], value), MAX_ENTRIES if node_counts[0] > 0 else 0)
        return [_shorten_value(item, node_counts) for item in items]
    return value
