"""A step of a job in one line."""

import pytest
from pydantic import TypeAdapter

from orchestrator.model.steps.repeat import JobStep

STEPS = TypeAdapter[JobStep](JobStep)


@pytest.mark.parametrize(
    ("plain", "text"),
    [
        (
            {"do": "move", "name": "far", "to": {"a.x": "12 cm", "b.u": 1}, "by": {"b.v": -0.5}, "align": "1500 ms"},
            "move 'far' to a.x=12 cm b.u=1, by b.v=-0.5, align=1.5 s",
        ),
        ({"do": "home"}, "home"),
        (
            {"do": "move", "by": {"a.x": 1}, "record": {"axes": ["a.x", "a.y"], "period": "10 ms"}},
            "move by a.x=1, record axes=a.x,a.y period=10 ms",
        ),
        ({"do": "enable", "axes": ["a", "b.u"]}, "enable axes a b.u"),
        ({"do": "output", "output": "a.lamp", "value": True}, "output output=a.lamp, value=true"),
        ({"do": "set-position", "axes": {"a.x": None, "a.y": 1}}, "set-position axes a.x=null a.y=1"),
    ],
)
def test_a_step_description_matches_its_file(plain: dict[str, object], text: str) -> None:
    assert STEPS.validate_python(plain).describe() == text
