"""What the lines of `tutti live` say."""

import click
import pytest

from orchestrator.cli.manual.live_lines import read_line
from orchestrator.model.steps.base import Step

AXES = ["gantry", "stage.u"]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('move gantry.x=10 stage.u="2 mm" --speed 0.5', "move to gantry.x=10.0 stage.u=2 mm, speed=50 %"),
        ("move gantry.x=1 --relative --line", "move by gantry.x=1.0, speed=manual, sync=phase"),
        ("home", "home axes gantry stage.u"),
        ("enable gantry", "enable axes gantry"),
        ("disable", "disable axes gantry stage.u"),
        ("set gantry.lamp on", "output output=gantry.lamp, value=true"),
        ('dwell "0.5 s"', "dwell duration=500 ms"),
        ('{"do": "move", "to": {"gantry.x": 3}}', "move to gantry.x=3"),
    ],
)
def test_steps(line: str, words: str) -> None:
    step = read_line(line, AXES)
    assert isinstance(step, Step)
    assert step.describe() == words


@pytest.mark.parametrize("line", ["", "   ", "# a comment"])
def test_lines_that_say_nothing(line: str) -> None:
    assert read_line(line, AXES) is None


@pytest.mark.parametrize("line", ["where", "stop", "end"])
def test_orders(line: str) -> None:
    assert read_line(line, AXES) == line


def test_help_lists_what_a_line_can_say(capsys: pytest.CaptureFixture[str]) -> None:
    assert read_line("help", AXES) is None
    shown = capsys.readouterr().out
    assert "AXIS=VALUE" in shown and "stop" in shown


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("moev gantry.x=1", "moev"),
        ("move", "Missing argument"),
        ("move gantry.x", "AXIS=VALUE"),
        ("move gantry.x=1 --speed 7", "fraction of the limits"),
        ("move gantry.x=nan", "not a position"),
        ('move gantry.x="1', "No closing quotation"),
        ("set gantry.lamp", "Missing argument"),
        ("set gantry.lamp maybe", "maybe"),
        ("dwell soon", "soon"),
        ("{", "no JSON"),
        ("{}", "do"),
        ('{"do": "scan"}', "scan"),
        ("[" * 5000, ""),
        ("{" + '"a":{' * 5000, ""),
    ],
)
def test_lines_that_cannot_be_read(line: str, text: str) -> None:
    with pytest.raises(click.ClickException) as caught:
        read_line(line, AXES)
    assert text in caught.value.format_message()
