"""A step of a job in one line."""

import pytest
from pydantic import TypeAdapter

from orchestrator.model.job import Step
from orchestrator.model.report import StepReport
from orchestrator.monitor.step_text import step_text

STEPS = TypeAdapter[Step](Step)


@pytest.mark.parametrize(
    ("plain", "text"),
    [
        (
            {"do": "move", "name": "far", "to": {"a.x": "12 cm", "b.u": 1}, "by": {"b.v": -0.5}, "align": "1500 ms"},
            "move 'far' to a.x=12 cm b.u=1, by b.v=-0.5, align=1.5 s",
        ),
        ({"do": "home"}, "home"),
        ({"do": "enable", "axes": ["a", "b.u"]}, "enable axes a b.u"),
        ({"do": "output", "output": "a.lamp", "value": True}, "output output=a.lamp, value=true"),
        ({"do": "set-position", "axes": {"a.x": None, "a.y": 1}}, "set-position axes a.x=null a.y=1"),
    ],
)
def test_a_step_says_what_its_file_says(plain: dict[str, object], text: str) -> None:
    assert step_text(STEPS.validate_python(plain)) == text


def test_a_step_that_is_over_says_how_it_went() -> None:
    step = STEPS.validate_python({"do": "dwell", "duration": "300 ms"})
    report = StepReport(index=0, do="dwell", name="", state="failed", reason="the fleet was stopped")
    assert step_text(step, report) == "dwell duration=300 ms: failed (the fleet was stopped)"
