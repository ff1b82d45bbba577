"""Local times that come never or twice: never taken for an earlier one."""

from collections.abc import Iterator
from datetime import datetime

import click
import pytest
from unit.cli.local_time import use_berlin_time

from orchestrator.cli.base.instants import InstantType


@pytest.fixture(autouse=True)
def berlin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    yield from use_berlin_time(monkeypatch)


def read(text: str) -> datetime:
    return InstantType().convert(text, None, None)


def test_a_time_that_does_not_come_is_refused_with_the_next_one() -> None:
    with pytest.raises(click.BadParameter, match=r"2027-03-28 02:30 does not come.*write 03:30"):
        read("2027-03-28 02:30")
    assert read("2027-03-28 03:30").isoformat() == "2027-03-28T03:30:00+02:00"
    assert read("2027-03-28T02:30:00+01:00").isoformat() == "2027-03-28T03:30:00+02:00"


def test_of_a_time_that_comes_twice_the_later_one_is_taken_and_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert read("2026-10-25 02:30").isoformat() == "2026-10-25T02:30:00+01:00"
    assert "comes twice; the later one is taken, 2026-10-25T02:30:00+01:00" in capsys.readouterr().err
    assert read("2026-10-25T02:30:00+02:00").isoformat() == "2026-10-25T02:30:00+02:00"
    assert capsys.readouterr().err == ""
