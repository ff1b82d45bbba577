"""Steps and jobs that a script constructs: errors of the one tree, and signatures that can be read."""

import inspect

import pytest

import tutti
from orchestrator.model.script import WrongValue


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"to": {"a.x": "5 kg"}}, "to.a.x: unknown unit 'kg'; known units: m, cm"),
        ({"by": {"a.x": "5 kg"}}, "by.a.x: unknown unit 'kg'"),
        ({"to": {"a.x": 1}, "sped": 2}, "sped: unknown field; did you mean speed?"),
        ({}, "Move: a move needs `to`"),
        ({"to": {"a.x": float("nan")}}, "to.a.x: "),
    ],
)
def test_a_step_that_cannot_be_is_an_error_of_tutti(fields: dict[str, object], text: str) -> None:
    with pytest.raises(tutti.TuttiError) as refused:
        tutti.Move(**fields)  # pyright: ignore[reportArgumentType]
    assert isinstance(refused.value, WrongValue)
    assert text in str(refused.value)
    assert "pydantic" not in str(refused.value)


def test_every_mistake_of_a_job_is_named_with_its_place() -> None:
    with pytest.raises(WrongValue) as refused:
        tutti.Job("", [], max_start_skew="soon")
    assert {problem.field for problem in refused.value.problems} == {"name", "steps", "max_start_skew"}


@pytest.mark.parametrize("model", [tutti.Move, tutti.Scan, tutti.FollowPath, tutti.Job, tutti.QueueTerms, tutti.Repeat])
def test_a_signature_has_types_without_their_checks(model: type) -> None:
    signature = str(inspect.signature(model))
    assert "Annotated" not in signature
    assert "FieldInfo" not in signature


def test_signatures_of_requests_have_none_either() -> None:
    for client in (tutti.Tutti, tutti.BlockingTutti):
        for name, method in inspect.getmembers(client, inspect.isfunction):
            assert name.startswith("_") or "Annotated" not in str(inspect.signature(method)), name
