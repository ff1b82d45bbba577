"""Mistakes in one line, for messages and logs."""

from pathlib import Path

import pytest
from pydantic import BaseModel, ValidationError

from orchestrator.model.problems import describe_first_error, first_error_text, read_problems

ROOT = Path(__file__).parents[3]


class Inner(BaseModel):
    speed: float


class Outer(BaseModel):
    axes: list[Inner]


def fail_at(text: str) -> ValidationError:
    with pytest.raises(ValidationError) as caught:
        Outer.model_validate_json(text)
    return caught.value


def test_the_first_mistake_has_its_place() -> None:
    error = fail_at('{"axes": [{"speed": 1}, {"speed": "x"}, {}]}')
    text = "Input should be a valid number, unable to parse string as a number"
    assert first_error_text(error) == text
    assert describe_first_error(error) == describe_first_error(error, "it") == f"axes.1.speed: {text}"
    assert [(problem.field, problem.found) for problem in read_problems(error)] == [
        ("axes.1.speed", "x"),
        ("axes.2.speed", {}),
    ]


def test_a_mistake_of_the_whole_has_the_place_that_is_given() -> None:
    error = fail_at("[]")
    text = first_error_text(error)
    assert describe_first_error(error) == text
    assert describe_first_error(error, "payload") == f"payload: {text}"
    assert describe_first_error(error, "") == f": {text}"


def test_errors_of_pydantic_are_read_only_in_the_model() -> None:
    others = [
        path.relative_to(ROOT).as_posix()
        for package in ("orchestrator", "adapters", "sim", "tutti")
        for path in (ROOT / package).rglob("*.py")
        if "error.errors(" in path.read_text(encoding="utf-8")
    ]
    assert sorted(others) == ["orchestrator/model/explain.py", "orchestrator/model/problems.py"]
