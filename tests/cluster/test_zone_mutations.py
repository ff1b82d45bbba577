"""Keep-out zones broken on purpose, in one place of the code: truth notices, in the campaign or in one job.

The watch of the running fleet stops what has come too near already, and so hides none of these but one.
"""

import asyncio
from collections.abc import Callable

import pytest
from cluster.test_zone_watch import HOME
from cluster.test_zones import ENABLE, zones_fleet
from cluster.worlds import give_word, job, outcome, run_fleet

from orchestrator.campaign.scenario import FaultCell, run_scenario
from orchestrator.campaign.stages.zone_truth import TRUTH, ZoneTruth
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.coordinator.fleet.zone_reservations import ZoneReservations
from orchestrator.coordinator.fleet.zone_watch import ZoneWatch
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport
from orchestrator.plan.zones import course, rules
from orchestrator.plan.zones.course import Course
from orchestrator.plan.zones.search import RuleCheck, Violation, find_rule_violation
from orchestrator.runtime.virtual.fleet import VirtualFleet

Patch = pytest.MonkeyPatch
Fault = Callable[[VirtualFleet], None]


def run_job(moved: Job, fault: Fault | None = None, *before: Job, trust_step: bool = False) -> tuple[JobReport, float]:
    """The report of a job of the example, with a fault 1.5 s after its submission, and the least that a rule was kept
    by."""

    async def main(fleet: VirtualFleet) -> tuple[JobReport, float]:
        await outcome(fleet, ENABLE, HOME, *before)
        truth = ZoneTruth(fleet)
        watching = asyncio.ensure_future(truth.watch())
        client = fleet.make_client()
        job_id = await client.submit(moved)
        await sleep_ns(fleet.clock, 1500 * NS_PER_MS)
        if fault is not None:
            fault(fleet)
        report = await client.wait_for_job(job_id, on_ready=give_word)
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        watching.cancel()
        return report, min(truth.nearest.values())

    plain = zones_fleet().to_plain()
    plain["controllers"]["stage"]["state"] = {"idle_hz": 1.25, "moving_hz": 3}  # it is found late that an axis stands
    plain["controllers"]["gantry"]["axes"]["x"]["following_error"] = 0.1
    plain["zones"]["rules"]["detector-sample"]["trust_step"] = trust_step
    return run_fleet(main, Fleet.model_validate(plain))


# Samples

THROUGH = job("[{do: move, to: {gantry.x: 300}}]")
"""Through the sample; the detector is clear of it where it begins and where it ends."""


def look_at_ends(rule: RuleCheck, moved: Course, *, trust_step: bool | None = None) -> Violation | None:
    """Where a step may break a rule as it begins or ends, and nothing of what is between."""
    del trust_step
    for instant_s in (0.0, moved.duration_s):
        box = moved.find_box(rule.constraint.axes, instant_s, instant_s, trust_step=True)
        if rule.constraint.look(box).holds is False:
            return Violation(rule, instant_s, {axis: sum(ends) / 2 for axis, ends in box.items()}, 0.0)
    return None


def test_samples_of_a_course_miss_what_is_between_them(monkeypatch: Patch) -> None:
    honest_report, _ = run_job(THROUGH)
    assert honest_report.state == "failed" and "zone detector-" in honest_report.reason
    monkeypatch.setattr(rules, "find_rule_violation", look_at_ends)
    _, nearest = run_job(THROUGH)
    assert nearest < -1.0


# Single stops

NEAR = job("[{do: move, to: {gantry.x: 153.6}}]")
IN_STEP = job(
    "[{do: move, to: {gantry.x: 188.6, stage.u: 35}, speed: 1, sync: phase}]",
    max_start_skew="20 ms",
    max_end_skew="20 ms",
)
"""The detector follows the sample, 6.4 mm behind it, at 10 mm/s."""


def press_limit_switch(fleet: VirtualFleet) -> None:
    fleet.act_on_controller("stage", lambda controller: controller.set_limit("1", "forward"))


def trust_each_step(monkeypatch: Patch) -> None:
    """And without the watch, which knows of no such trust: by readings of two instants axes are nearer than they are."""

    def find_trusting(rule: RuleCheck, moved: Course, *, trust_step: bool | None = None) -> Violation | None:
        del trust_step
        return find_rule_violation(rule, moved, trust_step=True)

    monkeypatch.setattr(rules, "find_rule_violation", find_trusting)
    monkeypatch.setattr(ZoneWatch, "take_state", lambda *_: None)


def test_axes_that_are_safe_only_in_step_are_refused() -> None:
    report, _ = run_job(IN_STEP, press_limit_switch, NEAR)
    assert report.state == "failed" and "and not where one of them stops and the others go on" in report.reason


def test_axes_that_are_trusted_to_keep_step_are_not_stopped_by_the_watch() -> None:
    """By readings of two instants they are nearer to each other than they are."""
    report, nearest = run_job(IN_STEP, None, NEAR, trust_step=True)
    assert report.state == "done" and nearest >= -TRUTH, report.reason


@pytest.mark.parametrize("fault", [None, press_limit_switch])
def test_without_single_stops_bodies_meet_when_one_axis_stops(fault: Fault | None, monkeypatch: Patch) -> None:
    """And only then: all is well while they keep step."""
    trust_each_step(monkeypatch)
    report, nearest = run_job(IN_STEP, fault, NEAR)
    if fault is None:
        assert report.state == "done" and nearest >= -TRUTH, report.reason
    else:
        assert report.state == "failed" and nearest < -0.1, (report.reason, nearest)


# In the campaign


def leave_margins_out(monkeypatch: Patch) -> None:
    """Axes are where they are said to be."""
    for module in (rules, course):
        monkeypatch.setattr(module, "find_margin", lambda axis: 0.0)


def reserve_nothing(monkeypatch: Patch) -> None:
    """A step is checked as if other jobs stood where they are."""
    monkeypatch.setattr(ZoneReservations, "reserve", lambda *_, **__: None)


@pytest.mark.parametrize(
    ("mutate", "seed", "make"),
    [(leave_margins_out, 0, "smc4000"), (reserve_nothing, 0, "smc4000")],
)
def test_the_campaign_finds_the_violation(
    mutate: Callable[[Patch], None], seed: int, make: str, monkeypatch: Patch
) -> None:
    mutate(monkeypatch)
    story = run_scenario(seed, [FaultCell("zone", "none", make)])
    assert any("was broken by" in text for text in story.violations), story.summarize()
