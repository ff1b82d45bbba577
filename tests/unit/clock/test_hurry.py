"""Real-time priorities: asked for where there are any, and never needed."""

import os

import pytest

from orchestrator.clock.hurry import Urgency, hurry


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, param: found.append((policy, param.sched_priority))
    )
    return found


def test_children_are_as_urgent_unless_they_are_not_meant_to_be(asked: list[tuple[int, int]]) -> None:
    assert hurry(Urgency.SERVICE)
    assert hurry(Urgency.GUARDIAN, children=False)
    assert asked == [(os.SCHED_RR, Urgency.SERVICE), (os.SCHED_RR | os.SCHED_RESET_ON_FORK, Urgency.GUARDIAN)]


def test_what_everybody_waits_for_goes_first() -> None:
    assert Urgency.FIRING > Urgency.GUARDIAN > Urgency.BUS > Urgency.SERVICE


@pytest.mark.parametrize("nice_too", [True, False])
def test_a_user_who_may_not_goes_on_without(monkeypatch: pytest.MonkeyPatch, nice_too: bool) -> None:
    niced: list[int] = []

    def refused(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    monkeypatch.setattr(os, "nice", niced.append if nice_too else refused)
    assert not hurry(Urgency.FIRING)
    assert [each < 0 for each in niced] == [True] * nice_too
