"""Real-time priorities: requested if available, and never required."""

import asyncio
import os
from collections.abc import Callable

import pytest

from orchestrator.clock.realtime import (
    YIELD_S,
    RealtimePriority,
    can_set_realtime_priority,
    set_realtime_priority,
    yield_priority,
)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, param: found.append((policy, param.sched_priority))
    )
    return found


def test_children_inherit_the_priority_unless_it_is_disabled(asked: list[tuple[int, int]]) -> None:
    assert set_realtime_priority(RealtimePriority.SERVICE)
    assert set_realtime_priority(RealtimePriority.GUARDIAN, children=False)
    assert asked == [
        (os.SCHED_RR, RealtimePriority.SERVICE),
        (os.SCHED_RR | os.SCHED_RESET_ON_FORK, RealtimePriority.GUARDIAN),
    ]


def test_a_process_that_all_wait_for_gets_priority() -> None:
    assert RealtimePriority.FIRING > RealtimePriority.GUARDIAN > RealtimePriority.BUS > RealtimePriority.SERVICE


@pytest.mark.parametrize("nice_too", [True, False])
def test_a_user_without_the_permission_continues_without_priority(
    monkeypatch: pytest.MonkeyPatch, nice_too: bool
) -> None:
    niced: list[int] = []

    def refused(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    monkeypatch.setattr(os, "nice", niced.append if nice_too else refused)
    assert not can_set_realtime_priority(RealtimePriority.FIRING)
    assert niced == []
    assert not set_realtime_priority(RealtimePriority.FIRING)
    assert [each < 0 for each in niced] == [True] * nice_too


def test_checking_the_permission_does_not_change_the_priority(asked: list[tuple[int, int]]) -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    assert can_set_realtime_priority(RealtimePriority.FIRING)
    assert asked == [(os.SCHED_RR, RealtimePriority.FIRING), before]


def test_a_process_that_yields_regains_its_priority_a_moment_later(
    asked: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        monkeypatch.setattr(loop, "call_later", lambda after_s, call, *values: later.append((after_s, call, values)))
        yield_priority(RealtimePriority.SERVICE)

    later: list[tuple[float, Callable[..., object], tuple[object, ...]]] = []
    asyncio.run(main())
    assert asked == [(os.SCHED_OTHER, 0)]
    ((after_s, call, values),) = later
    assert after_s == YIELD_S
    call(*values)
    assert asked[1:] == [(os.SCHED_RR, RealtimePriority.SERVICE)]
