"""The lead over arming: as members declare it at first, as short as they have shown later, and long again for one that
is late."""

import asyncio
from dataclasses import replace
from statistics import median

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, origin_host_ns, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.coordinator.motion.lead_time import (
    ARM_FACTOR,
    GO_FACTOR,
    KEPT_STEPS,
    KNOWN_AFTER,
    MARGIN_NS,
    MARGIN_PER_MEMBER_NS,
    MIN_MARGIN_NS,
    SLOW_GO_FACTOR,
    LeadTimeEstimator,
)
from orchestrator.model.queue import StartPolicy
from orchestrator.runtime.virtual.fleet import VirtualFleet

STEPS = "[{do: move, to: {gantry.x: %d, stage.u: %d}}]"


def test_a_measured_fleet_starts_sooner_and_a_late_member_is_armed_again() -> None:
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

        waits = [await waited_ns(k) for k in range(KNOWN_AFTER + 2)]
        assert median(waits[:KNOWN_AFTER]) - waits[-1] > 20 * NS_PER_MS
        # The network becomes slow: the measured times are wrong, and the declared times count.
        for wire in fleet.wires.values():
            wire.model = replace(wire.model, latency_ns=12 * NS_PER_MS)
        slow = await waited_ns(KNOWN_AFTER)
        assert slow > waits[-1]
        assert any("arming again with more lead" in line for line in fleet.lines)

    run_fleet(main)


@pytest.mark.parametrize(("busy_ms", "again"), [(150, False), (280, True)])
def test_a_member_that_was_too_busy_to_promise_in_time_is_armed_again(busy_ms: int, again: bool) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        for k in range(KNOWN_AFTER):
            await outcome(fleet, job(STEPS % (10 + k % 2, 1 + k % 2), max_start_skew="20 ms"))
        starts = {name: len(each.commanded_motions) for name, each in fleet.controllers.items()}

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
        assert {name: len(each.commanded_motions) - starts[name] for name, each in fleet.controllers.items()} == {
            "gantry": 1,
            "stage": 1,
        }

    run_fleet(main)


@pytest.mark.parametrize(("release_ms", "state"), [(0, "failed"), (150, "done")])
def test_a_busy_host_fails_no_step_whose_release_has_time(release_ms: int, state: str) -> None:
    """It stops between the two answers to `go`. With little time, the member that has answered starts before it can be
    unloaded; with more, both are armed again."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        for k in range(KNOWN_AFTER):
            await outcome(fleet, job(STEPS % (10 + k % 2, 1 + k % 2), max_start_skew="20 ms"))

        told = len(fleet.lines)
        running = asyncio.ensure_future(outcome(fleet, job(STEPS % (20, 3), max_start_skew="20 ms")))
        while not any("job is committed" in line for line in fleet.lines[told:]):
            await sleep_ns(fleet.clock, NS_PER_MS // 10)
        await sleep_ns(fleet.clock, 2 * NS_PER_MS)
        fleet.freeze("host/local")
        await sleep_ns(fleet.clock, 250 * NS_PER_MS)
        fleet.resume("host/local")
        assert (await running).state == state

    starts = StartPolicy.model_validate({"release": f"{release_ms} ms"})
    run_fleet(main, demo_fleet().model_copy(update={"starts": starts}))


def test_a_release_gets_at_least_what_the_fleet_file_says() -> None:
    pace = LeadTimeEstimator(lambda: 80 * NS_PER_MS)
    for _ in range(KNOWN_AFTER):
        pace.record_release(20 * NS_PER_MS, 10 * NS_PER_MS)
        pace.record_following(5 * NS_PER_MS)
    assert pace.go_ns(2) == pace.go_ns(2, follows=True) == 80 * NS_PER_MS
    assert pace.margin_ns(2) == (10 + 80) * NS_PER_MS


def test_measured_times_need_enough_steps_and_do_not_apply_to_a_late_member() -> None:
    pace = LeadTimeEstimator()
    for k in range(KNOWN_AFTER):
        assert pace.arming_share("a") == 1.0 and pace.margin_ns(2) == MARGIN_NS
        pace.record_arming("rest", {"a": 100, "b": 0}, {"a": 10 + k, "b": 5})
        pace.record_release(20 * NS_PER_MS, 10 * NS_PER_MS)
    assert pace.arming_share("a") == pytest.approx(ARM_FACTOR * (10 + KNOWN_AFTER - 1) / 100)
    assert pace.arming_share("b") == 1.0
    assert pace.go_ns(2) == round(GO_FACTOR * 10 * NS_PER_MS) == pace.go_ns(2, NS_PER_MS)
    # A member that was slow to promise gets as much more time for `go`.
    assert pace.go_ns(2, 20 * NS_PER_MS) == SLOW_GO_FACTOR * 20 * NS_PER_MS
    # For the whole release, and the margin of `go` beyond its duration.
    assert pace.margin_ns(2) == round((ARM_FACTOR * 20 + (GO_FACTOR - 1) * 10) * NS_PER_MS) > MIN_MARGIN_NS
    assert pace.arming_share("a", use_known=False) == 1.0 and pace.margin_ns(2, use_known=False) == MARGIN_NS


def test_the_duration_of_late_promises_counts_from_then_on_within_bounds() -> None:
    pace = LeadTimeEstimator()
    for _ in range(KNOWN_AFTER):
        pace.record_release(20 * NS_PER_MS, 10 * NS_PER_MS)
    pace.record_late_promise(25 * NS_PER_MS, 2)
    given_ns = pace.margin_ns(2)
    assert given_ns == round((ARM_FACTOR * (25 + 10) + (GO_FACTOR - 1) * 10) * NS_PER_MS)
    pace.record_late_promise(60 * NS_PER_S, 2)
    assert pace.margin_ns(2) < ARM_FACTOR * 2 * given_ns + 10 * NS_PER_MS


@pytest.mark.parametrize("steps", [0, 1, KNOWN_AFTER])
def test_a_slow_go_gets_more_time_and_the_lead_includes_it(steps: int) -> None:
    pace = LeadTimeEstimator()
    for _ in range(steps):
        pace.record_release(20 * NS_PER_MS, 10 * NS_PER_MS)
    for _ in range(10):
        given_ns = pace.go_ns(2)
        pace.record_late_go(2)
        assert pace.go_ns(2) == pytest.approx(GO_FACTOR * given_ns, rel=0.01)
        assert pace.margin_ns(2) > pace.go_ns(2) + 5 * NS_PER_MS
        assert pace.margin_ns(2, use_known=False) >= pace.go_ns(2) + MARGIN_NS // 2


def test_many_members_get_more_time_until_they_are_measured() -> None:
    pace = LeadTimeEstimator()
    assert pace.margin_ns(16) == 16 * MARGIN_PER_MEMBER_NS > MARGIN_NS and pace.go_ns(16) == 8 * MARGIN_PER_MEMBER_NS
    for _ in range(KNOWN_AFTER):
        pace.record_release(20 * NS_PER_MS, 10 * NS_PER_MS)
    assert pace.margin_ns(16) == pace.margin_ns(2)


def test_a_member_that_takes_longer_than_declared_gets_more_lead_at_once() -> None:
    pace = LeadTimeEstimator()
    pace.record_arming("rest", {"a": 100}, {"a": 130})
    pace.record_release(2 * MARGIN_NS, MARGIN_NS)
    assert pace.arming_share("a") == pytest.approx(1.3)
    assert pace.margin_ns(2) == 2 * MARGIN_NS and pace.go_ns(2) == MARGIN_NS
    assert pace.arming_share("a", use_known=False) == pytest.approx(1.3)
    assert pace.margin_ns(2, use_known=False) == 2 * MARGIN_NS
    for _ in range(KEPT_STEPS):
        pace.record_arming("rest", {"a": 100}, {"a": 50})
    assert pace.arming_share("a") == pytest.approx(ARM_FACTOR * 0.5)


def test_the_slowest_of_many_steps_is_remembered_for_longer_than_a_fleet_takes_to_be_measured() -> None:
    pace = LeadTimeEstimator()
    pace.record_arming("rest", {"a": 100}, {"a": 90})
    for _ in range(KEPT_STEPS - 1):
        pace.record_arming("rest", {"a": 100}, {"a": 50})
    assert pace.arming_share("a") == pytest.approx(ARM_FACTOR * 0.9)
    pace.record_arming("rest", {"a": 100}, {"a": 50})
    assert pace.arming_share("a") == pytest.approx(ARM_FACTOR * 0.5)
