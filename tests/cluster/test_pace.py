"""The lead over arming: as members declare it at first, as short as they have shown later, and long again for one that
is late."""

import asyncio
from dataclasses import replace
from statistics import median

import pytest
from cluster.worlds import PREPARE, job, origin_host_ns, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.coordinator.motion.lead_time import (
    EACH_NS,
    GO_ROOM,
    KEPT,
    KNOWN,
    LEAST_MARGIN_NS,
    MARGIN_NS,
    ROOM,
    SLOW_GO,
    Pace,
)
from orchestrator.runtime.virtual import VirtualFleet

STEPS = "[{do: move, to: {gantry.x: %d, stage.u: %d}}]"


def test_a_fleet_that_is_known_begins_sooner_and_one_that_is_late_is_armed_again() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        origin_ns = origin_host_ns(fleet)

        async def waited_ns(k: int) -> int:
            asked_ns = fleet.clock.now_ns() - origin_ns
            report = await outcome(fleet, job(STEPS % (10 + k % 2, 1 + k % 2), max_start_skew="20 ms"))
            assert report.state == "done", report.reason
            t0_ns = report.steps[0].t0_fleet_ns
            assert t0_ns is not None
            return t0_ns - asked_ns

        waits = [await waited_ns(k) for k in range(KNOWN + 2)]
        assert median(waits[:KNOWN]) - waits[-1] > 20 * NS_PER_MS
        # The network becomes slow: what was known is wrong, and the declared times count.
        for wire in fleet.wires.values():
            wire.model = replace(wire.model, latency_ns=12 * NS_PER_MS)
        slow = await waited_ns(KNOWN)
        assert slow > waits[-1]
        assert any("arming again with more lead" in line for line in fleet.lines)

    run_fleet(main)


@pytest.mark.parametrize(("busy_ms", "again"), [(150, False), (250, True)])
def test_a_member_that_was_too_busy_to_promise_in_time_is_armed_again(busy_ms: int, again: bool) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        for k in range(KNOWN):
            await outcome(fleet, job(STEPS % (10 + k % 2, 1 + k % 2), max_start_skew="20 ms"))
        starts = {name: len(each.motions) for name, each in fleet.controllers.items()}

        told = len(fleet.lines)
        running = asyncio.ensure_future(outcome(fleet, job(STEPS % (20, 3), max_start_skew="20 ms")))
        while not any("job is armed" in line for line in fleet.lines[told:]):
            await sleep_ns(fleet.clock, NS_PER_MS // 10)
        fleet.freeze("host/local")
        await sleep_ns(fleet.clock, busy_ms * NS_PER_MS)
        fleet.resume("host/local")
        report = await running
        assert report.state == "done", report.reason
        why = "arming again with more lead (gantry: gantry has not answered commit"
        assert any(why in line for line in fleet.lines[told:]) is again
        assert {name: len(each.motions) - starts[name] for name, each in fleet.controllers.items()} == {
            "gantry": 1,
            "stage": 1,
        }

    run_fleet(main)


def test_what_is_known_needs_so_many_steps_and_does_not_count_for_one_that_was_late() -> None:
    pace = Pace()
    for k in range(KNOWN):
        assert pace.share("a") == 1.0 and pace.margin_ns(2) == MARGIN_NS
        pace.armed({"a": 100, "b": 0}, {"a": 10 + k, "b": 5})
        pace.released(20 * NS_PER_MS, 10 * NS_PER_MS)
    assert pace.share("a") == pytest.approx(ROOM * (10 + KNOWN - 1) / 100)
    assert pace.share("b") == 1.0
    assert pace.go_ns(2) == round(GO_ROOM * 10 * NS_PER_MS) == pace.go_ns(2, NS_PER_MS)
    # Who was slow to promise is given as much more to go.
    assert pace.go_ns(2, 20 * NS_PER_MS) == SLOW_GO * 20 * NS_PER_MS
    # For the whole release, and what go is given beyond what it takes.
    assert pace.margin_ns(2) == round((ROOM * 20 + (GO_ROOM - 1) * 10) * NS_PER_MS) > LEAST_MARGIN_NS
    assert pace.share("a", known=False) == 1.0 and pace.margin_ns(2, known=False) == MARGIN_NS


def test_how_long_promises_took_that_were_late_counts_from_then_on_within_reason() -> None:
    pace = Pace()
    for _ in range(KNOWN):
        pace.released(20 * NS_PER_MS, 10 * NS_PER_MS)
    pace.late(25 * NS_PER_MS, 2)
    given_ns = pace.margin_ns(2)
    assert given_ns == round((ROOM * (25 + 10) + (GO_ROOM - 1) * 10) * NS_PER_MS)
    pace.late(60 * NS_PER_S, 2)
    assert pace.margin_ns(2) < ROOM * 2 * given_ns + 10 * NS_PER_MS


@pytest.mark.parametrize("steps", [0, 1, KNOWN])
def test_go_that_was_too_slow_is_given_more_and_the_lead_has_room_for_it(steps: int) -> None:
    pace = Pace()
    for _ in range(steps):
        pace.released(20 * NS_PER_MS, 10 * NS_PER_MS)
    for _ in range(10):
        given_ns = pace.go_ns(2)
        pace.late_to_go(2)
        assert pace.go_ns(2) == pytest.approx(GO_ROOM * given_ns, rel=0.01)
        assert pace.margin_ns(2) > pace.go_ns(2) + 5 * NS_PER_MS
        assert pace.margin_ns(2, known=False) >= pace.go_ns(2) + MARGIN_NS // 2


def test_many_members_are_given_more_until_they_are_known() -> None:
    pace = Pace()
    assert pace.margin_ns(16) == 16 * EACH_NS > MARGIN_NS and pace.go_ns(16) == 8 * EACH_NS
    for _ in range(KNOWN):
        pace.released(20 * NS_PER_MS, 10 * NS_PER_MS)
    assert pace.margin_ns(16) == pace.margin_ns(2)


def test_who_takes_longer_than_declared_is_given_more_at_once() -> None:
    pace = Pace()
    pace.armed({"a": 100}, {"a": 130})
    pace.released(2 * MARGIN_NS, MARGIN_NS)
    assert pace.share("a") == pytest.approx(1.3)
    assert pace.margin_ns(2) == 2 * MARGIN_NS and pace.go_ns(2) == MARGIN_NS
    assert pace.share("a", known=False) == pytest.approx(1.3)
    assert pace.margin_ns(2, known=False) == 2 * MARGIN_NS
    for _ in range(KEPT):
        pace.armed({"a": 100}, {"a": 50})
    assert pace.share("a") == pytest.approx(ROOM * 0.5)


def test_the_slowest_of_many_steps_is_remembered_for_longer_than_it_takes_to_know_a_fleet() -> None:
    pace = Pace()
    pace.armed({"a": 100}, {"a": 90})
    for _ in range(KEPT - 1):
        pace.armed({"a": 100}, {"a": 50})
    assert pace.share("a") == pytest.approx(ROOM * 0.9)
    pace.armed({"a": 100}, {"a": 50})
    assert pace.share("a") == pytest.approx(ROOM * 0.5)
