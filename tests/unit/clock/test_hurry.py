"""Real-time priorities: asked for where there are any, and never needed."""

import asyncio
import os
from collections.abc import Callable

import pytest

from orchestrator.clock.realtime import STEP_BACK_S, Urgency, hurry, may_hurry, step_back


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
    assert not may_hurry(Urgency.FIRING)
    assert niced == []
    assert not hurry(Urgency.FIRING)
    assert [each < 0 for each in niced] == [True] * nice_too


def test_who_asks_whether_it_may_is_as_urgent_as_before(asked: list[tuple[int, int]]) -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    assert may_hurry(Urgency.FIRING)
    assert asked == [(os.SCHED_RR, Urgency.FIRING), before]


def test_who_steps_back_is_as_urgent_again_a_moment_later(
    asked: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        monkeypatch.setattr(loop, "call_later", lambda after_s, call, *values: later.append((after_s, call, values)))
        step_back(Urgency.SERVICE)

    later: list[tuple[float, Callable[..., object], tuple[object, ...]]] = []
    asyncio.run(main())
    assert asked == [(os.SCHED_OTHER, 0)]
    ((after_s, call, values),) = later
    assert after_s == STEP_BACK_S
    call(*values)
    assert asked[1:] == [(os.SCHED_RR, Urgency.SERVICE)]
