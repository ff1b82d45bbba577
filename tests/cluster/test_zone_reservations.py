"""Steps of parallel jobs and keep-out zones: one waits for the other instead of meeting it, or is refused."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import pytest
from cluster.test_zone_seeds import ZoneRun
from cluster.test_zone_watch import HOME
from cluster.test_zones import ENABLE, zones_fleet
from cluster.worlds import job, outcome, run_fleet

from orchestrator.campaign.stages.zone_truth import TRUTH, ZoneTruth
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.fleet.zone_reservations import ZONE_BUSY, ZoneReservations
from orchestrator.coordinator.fleet.zones import ZoneGuard, ZoneMover, query_rest_positions
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import JobReport
from orchestrator.model.state import ControllerState
from orchestrator.plan.zones.course import Sweep, Timing
from orchestrator.plan.zones.memory import ZoneMemory
from orchestrator.runtime.virtual.fleet import VirtualFleet

# Turned by 40 degrees, a corner of the arm is 4 mm nearer to the detector than it may be at 152 mm.
TURN = job("[{do: move, to: {stage.phi: 40}, speed: 5 deg/s}, {do: move, to: {stage.phi: 0}, speed: 5 deg/s}]")
APPROACH = job("[{do: move, to: {gantry.x: 152}}]")


def run_beside(
    jobs: Sequence[Job], *before: Job, apart_s: float = 0.3, now: bool = False
) -> tuple[list[JobReport], ZoneRun]:
    """The reports of jobs that are submitted one shortly after the other, and how near bodies came by truth."""
    run = ZoneRun()

    async def main(fleet: VirtualFleet) -> list[JobReport]:
        await outcome(fleet, ENABLE, HOME, *before)
        truth = ZoneTruth(fleet)
        run.nearest, watching = truth.nearest, asyncio.ensure_future(truth.watch())
        client = fleet.make_client()
        ids: list[str] = []
        for number, each in enumerate(jobs):
            ids.append(await client.submit(each, terms=QueueTerms(now=now and number > 0)))
            await sleep_ns(fleet.clock, round(apart_s * NS_PER_S))
        reports = [await client.wait_for_job(job_id) for job_id in ids]
        watching.cancel()
        return reports

    return run_fleet(main, zones_fleet()), run


def test_a_step_waits_for_a_step_of_another_job_and_goes_on_behind_it() -> None:
    """The arm sweeps through where the detector would stand, and is away again when its job has ended."""
    (turned, approached), run = run_beside([TURN, APPROACH])
    assert turned.state == "done" and approached.state == "done", (turned.reason, approached.reason)
    assert turned.ended_utc is not None and approached.steps[0].t0_fleet_ns is not None
    assert approached.steps[0].t0_fleet_ns > max(step.settled_fleet_ns or 0 for step in turned.steps)
    assert 2.5 < run.nearest["detector-sample"] < 3.5


def test_what_is_not_to_wait_is_refused_with_the_job_that_is_in_its_way() -> None:
    (turned, refused), run = run_beside([TURN, APPROACH], now=True)
    assert turned.state == "done", turned.reason
    assert refused.state == "failed" and "it was submitted not to wait" in refused.reason, refused.reason
    assert f"job {turned.job_id} has stage.phi" in refused.reason
    assert min(run.nearest.values()) >= -TRUTH


def test_a_step_that_stays_in_the_way_is_waited_for_no_longer_than_a_minute() -> None:
    """The stage stands where the detector is to go, and its job lasts."""
    stand = job("[{do: move, to: {stage.u: 5}}, {do: dwell, duration: 100 s}]")
    over = job("[{do: move, to: {gantry.x: 230}}]")
    (stood, refused), _ = run_beside([stand, over])
    assert stood.state == "done"
    assert refused.state == "failed" and "it has waited for 6" in refused.reason, refused.reason
    assert f"job {stood.job_id} has stage" in refused.reason


def test_jobs_that_move_in_different_places_move_at_the_same_time() -> None:
    (left, right), _ = run_beside([TURN, job("[{do: move, to: {gantry.x: 60}}, {do: move, to: {gantry.x: 0}}]")])
    assert left.state == right.state == "done", (left.reason, right.reason)
    assert left.started_utc is not None and right.ended_utc is not None and left.ended_utc is not None
    assert right.ended_utc < left.ended_utc  # it did not wait


def test_two_jobs_that_wait_for_each_other_are_found() -> None:
    """Each stands where the other one is to go."""
    first = job("[{do: move, to: {gantry.x: 100}}, {do: dwell, duration: 2 s}, {do: move, to: {gantry.x: 230}}]")
    low = "[{do: move, to: {stage.u: 1}}, {do: dwell, duration: 1 s}, {do: move, to: {stage.phi: 60}}]"
    reports, run = run_beside([first, job(low)])
    reasons = [report.reason for report in reports if report.state == "failed"]
    assert reasons, [report.state for report in reports]
    assert min(run.nearest.values()) >= -TRUTH


def test_of_two_that_would_wait_for_each_other_the_second_does_not() -> None:
    async def main() -> None:
        reservations = ZoneReservations()
        for holder in ("a", "b", "c"):
            reservations.enter(holder)
        reservations.note_blockers("a", ["b"])
        reservations.note_blockers("b", ["c"])
        reservations.note_blockers("c", ["a"])
        assert reservations.begin_wait("a") is None and reservations.begin_wait("b") is None
        assert reservations.begin_wait("c") == "a"  # by way of b
        reservations.end_wait("b")
        assert reservations.begin_wait("c") is None

    asyncio.run(main())


class EndingJob:
    """A fleet at rest whose job `a`, which has the stage, ends while a step of another job is checked: as its controller
    is asked for its state, or later."""

    def __init__(self, states: Mapping[str, ControllerState], *, ends_at_query: bool) -> None:
        self._ends_at_query = ends_at_query
        self.fleet = zones_fleet()
        self.reservations = ZoneReservations()
        self.reservations.enter("a")
        self.reservations.enter("b")
        leases = {"u": "a", "phi": "a"}
        self._states = {**states, "stage": states["stage"].model_copy(update={"leases": leases})}

    def is_silent(self, controller: str) -> bool:
        return controller not in self._states

    def last_state(self, controller: str) -> ControllerState:
        return self._states[controller]

    async def query_state(self, controller: str) -> ControllerState:
        if controller == "stage" and self._ends_at_query:
            self.reservations.leave("a")
        return self._states[controller]

    async def leave_first(self, function: Callable[..., Any], *values: Any) -> Any:
        self.reservations.leave("a")
        return function(*values)


def read_states() -> Mapping[str, ControllerState]:
    async def main(fleet: VirtualFleet) -> Mapping[str, ControllerState]:
        await outcome(fleet, ENABLE, HOME)
        return await fleet.make_client().status(1.0)

    return run_fleet(main, zones_fleet())


def test_axes_of_a_job_that_ends_during_a_check_stand_where_they_are() -> None:
    view = EndingJob(read_states(), ends_at_query=True)
    query = query_rest_positions(cast(FleetView, view), ["stage.u", "gantry.x"], {}, "b", view.reservations)
    assert asyncio.run(query).keys() == {"stage.u", "gantry.x"}
    assert not view.reservations.is_job("a")


def test_a_step_that_is_refused_for_a_job_that_ends_during_the_check_waits() -> None:
    """It is checked again, and not refused for what is no longer so."""
    view = EndingJob(read_states(), ends_at_query=False)
    view.reservations.reserve("a", 0, {"stage.phi": (0, 60)})
    guard = ZoneGuard(cast(FleetView, view), ZoneMemory(), view.reservations, view.leave_first)
    sweep = Sweep({}, {"gantry.x": (0, 152)}, Timing({}), ["gantry.x"])
    with pytest.raises(Refusal, match=r"job a has stage\.phi, stage\.u") as failure:
        asyncio.run(guard.require(sweep, ZoneMover("b", 0)))
    assert failure.value.code == ZONE_BUSY


def test_a_job_that_looks_again_waits_for_nothing_known() -> None:
    """What it waited for has moved on: it is in the way of none that waits for it."""
    reservations = ZoneReservations()
    for holder in ("a", "b"):
        reservations.enter(holder)
        reservations.reserve(holder, 0, {"x": (0, 1)})
    reservations.note_blockers("a", ["b"])
    reservations.note_blockers("b", ["a"])
    assert reservations.begin_wait("a") is None
    reservations.end("b", 0)
    assert reservations.begin_wait("b") is None
    assert reservations.begin_wait("a") == "b"


def test_a_job_waits_for_those_alone_that_have_axes_of_the_rule() -> None:
    """The stage turns into the way of the detector; with the column the job that lifts it has nothing to do."""
    view = EndingJob(read_states(), ends_at_query=False)
    guard = ZoneGuard(cast(FleetView, view), ZoneMemory(), view.reservations, view.leave_first)
    sweep = Sweep({}, {"gantry.x": (390, 399)}, Timing({}), ["gantry.x"])
    with pytest.raises(Refusal, match="zone column") as failure:
        asyncio.run(guard.require(sweep, ZoneMover("b", 0)))
    assert failure.value.code == "zone"


@pytest.mark.parametrize("behind", [True, False])
def test_a_reservation_ends_with_its_step(behind: bool) -> None:
    async def main() -> None:
        reservations = ZoneReservations()
        reservations.reserve("no job", 0, {"x": (0, 1)})
        assert reservations.find_box("x", "b") is None
        reservations.enter("a")
        reservations.reserve("a", 0, {"x": (0, 1)})
        reservations.reserve("a", 1, {"x": (1, 5)}, behind=behind)
        assert reservations.find_box("x", "b") == ((0, 5) if behind else (1, 5))
        assert reservations.find_box("x", "a") is None and reservations.find_box("y", "b") is None
        reservations.end("a", 0)
        assert reservations.find_box("x", "b") == (1, 5)
        reservations.leave("a")
        assert reservations.find_box("x", "b") is None and not reservations.is_job("a")

    asyncio.run(main())
