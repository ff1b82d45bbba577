"""`--speed`: a fraction, percent, a speed with its unit, or the manual one."""

import click
import pytest

from orchestrator.cli.base.speeds import SpeedType


@pytest.mark.parametrize(
    ("text", "speed"), [("0.5", 0.5), ("50 %", 0.5), ("50%", 0.5), ("5 mm/s", "5 mm/s"), ("manual", "manual")]
)
def test_speeds_are_read(text: str, speed: float | str) -> None:
    assert SpeedType().convert(text, None, None) == speed


@pytest.mark.parametrize("text", ["5", "0", "fast", "-1 mm/s", "200 %"])
def test_other_speeds_are_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match="speed"):
        SpeedType().convert(text, None, None)
