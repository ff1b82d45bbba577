"""Steps of one controller that start as soon as it can: what starts them, what prevents that, and how often they run."""

from collections.abc import Callable
from typing import Any

import pytest
from cluster.test_back_to_back import breaks, chained, gaps_ms, motions, wait_for_motion
from cluster.worlds import PREPARE, job, origin_host_ns, outcome, run_fleet

from orchestrator.bus.base import RequestTimeout
from orchestrator.client.jobs import SubmittedJob
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.coordinator.fleet.requests import MemberRequests
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.model.errors import TuttiError
from orchestrator.model.fleet import Fleet
from orchestrator.model.report import JobReport
from orchestrator.runtime.simulated_fleets import make_ppsmc, make_smc30
from orchestrator.runtime.virtual.fleet import VirtualFleet

PAIR = job("[{do: move, to: {stage.u: 12}, start: at_once}, {do: move, to: {stage.u: 2}, start: at_once}]")


def to_and_fro(axis: str, to: float, pairs: int, start: str = "at_once") -> str:
    pair = ", ".join(f"{{do: move, to: {{{axis}: {target}}}, start: {start}}}" for target in (to, 0))
    return f"[{', '.join([pair] * pairs)}]"


async def submit_pair(fleet: VirtualFleet, delay_ms: int) -> SubmittedJob:
    """Submit `PAIR`; return that long after its second step was decided, which waits for the end of the first then."""
    submitted = await fleet.make_client().submit(PAIR)
    await wait_for_motion(fleet, "stage", "1")
    while len(fleet.journal.list_decisions(submitted.id)) < 2:
        await sleep_ns(fleet.clock, NS_PER_MS // 4)
    await sleep_ns(fleet.clock, delay_ms * NS_PER_MS)
    return submitted


def is_moving(fleet: VirtualFleet) -> bool:
    stage = fleet.controllers["stage"]
    return any(stage.is_moving(name) for name in stage.axis_names)


def require_decisions(fleet: VirtualFleet, report: JobReport, controller: str, motor: str) -> None:
    """Each motion of the job began after the decision of its step, and each step has one."""
    journal, moved = fleet.journal, motions(fleet, controller, motor)[-len(report.steps) :]
    decisions = journal.list_decisions(report.job_id)
    assert [step for step, _ in decisions] == [step.index for step in report.steps]
    for (start_ns, _), (_, decided_ns), step in zip(moved, decisions, report.steps, strict=True):
        assert step.t0_fleet_ns is not None and decided_ns < step.t0_fleet_ns
        assert decided_ns + origin_host_ns(fleet) < start_ns


def test_a_step_at_once_begins_sooner_than_an_agreed_one_and_keeps_its_verdict() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        medians: dict[str, float] = {}
        for start in ("agreed", "at_once"):
            await outcome(fleet, job(to_and_fro("stage.u", 4, 10, start)))  # what this fleet needs is known then
            report = await outcome(fleet, job(to_and_fro("stage.u", 4, 5, start)))
            assert report.state == "done" and chained(report) == [None, *[True] * 9]
            assert all(step.verdict == "green" for step in report.steps)
            medians[start] = sorted(gaps_ms(fleet, "stage", "1", 10))[4]
        require_decisions(fleet, report, "stage", "1")
        assert medians["at_once"] < medians["agreed"], medians

    run_fleet(main)


@pytest.mark.parametrize(
    ("make", "most_ms"),
    [(lambda: make_smc30(0, 1), 345.0), (lambda: make_ppsmc(0), 470.0)],
    ids=["smc30", "ppsmc"],
)
def test_slow_lines_gain_most(make: Callable[[], dict[str, Any]], most_ms: float) -> None:
    plain = {"schema": "tutti.fleet/1", "fleet": "one", "controllers": {"c": make()}}

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job("[{do: enable, axes: [c]}, {do: home}]"))
        to = float(fleet.fleet.axis("c.x").to_unit(2000))
        report = await outcome(fleet, job(to_and_fro("c.x", to, 6)))
        assert report.state == "done", report.reason
        assert all(step.verdict == "green" for step in report.steps)
        motor = fleet.controllers["c"].axis_names[0]
        assert max(gaps_ms(fleet, "c", motor, 6)) < most_ms
        require_decisions(fleet, report, "c", motor)

    run_fleet(main, Fleet.model_validate(plain))


@pytest.mark.parametrize(
    ("step", "text"),
    [
        ("{do: move, to: {gantry.x: 5, stage.u: 2}, start: at_once}", "it has 2 controllers"),
        ("{do: move, to: {gantry.x: 5}, align: 100 ms, start: at_once}", "`align` waits"),
    ],
)
def test_what_needs_an_agreement_cannot_start_at_once(step: str, text: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        try:
            report = await outcome(fleet, job(f"[{step}]"))
        except TuttiError as error:
            assert text in str(error)
        else:
            assert report.state == "failed" and text in report.reason
        assert not motions(fleet, "gantry", "X")[1:]  # homing alone

    run_fleet(main)


@pytest.mark.parametrize("delay_ms", [5, *(pytest.param(delay_ms, marks=pytest.mark.nightly) for delay_ms in (0, 10))])
def test_a_pause_withdraws_a_step_that_waits(delay_ms: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        await outcome(fleet, job(to_and_fro("stage.u", 4, 10)))
        submitted = await submit_pair(fleet, delay_ms)
        moved = motions(fleet, "stage", "1")
        assert fleet.controllers["stage"].is_moving("1"), "it waits"
        await submitted.pause()
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        assert len(motions(fleet, "stage", "1")) == len(moved) + 1
        assert len(fleet.journal.list_decisions(submitted.id)) == 1
        await submitted.resume()
        report = await submitted.result()
        assert report.state == "done" and breaks(report) == ["the job is paused"]
        assert [step for step, _ in fleet.journal.list_decisions(submitted.id)] == [0, 1]

    run_fleet(main)


async def run_behind(fleet: VirtualFleet, act: Callable[[VirtualFleet, Any], Any], delay_ms: int) -> JobReport:
    """Two steps of the stage; `act` that long after the second was decided, which waits then or has begun."""
    await outcome(fleet, PREPARE)
    await outcome(fleet, job(to_and_fro("stage.u", 4, 10)))
    submitted = await submit_pair(fleet, delay_ms)
    await act(fleet, submitted)
    await sleep_ns(fleet.clock, 3 * NS_PER_S)
    return await submitted.result()


@pytest.mark.parametrize(
    "delay_ms", [2, *(pytest.param(delay_ms, marks=pytest.mark.nightly) for delay_ms in (0, 20, 40, 70))]
)
@pytest.mark.parametrize("what", ["stop", "estop", "cancel", "hold"])
def test_what_ends_a_job_also_ends_the_step_that_waits_behind(what: str, delay_ms: int) -> None:
    async def act(fleet: VirtualFleet, submitted: Any) -> None:
        client = fleet.make_client()
        if what == "stop":
            await client.stop()
        elif what == "estop":
            await client.estop()
        elif what == "cancel":
            await submitted.cancel()
        else:
            await submitted.pause(now=True)
            await sleep_ns(fleet.clock, NS_PER_S)
            assert not is_moving(fleet)
            await submitted.cancel()

    async def main(fleet: VirtualFleet) -> None:
        report = await run_behind(fleet, act, delay_ms)
        assert report.state in ("aborted", "cancelled", "failed"), report
        done = [step for step in report.steps if step.state == "done"]
        moved = motions(fleet, "stage", "1")
        # The second step has not begun, or was stopped within a ramp.
        assert len(done) < 2 or moved[-1][1] - moved[-1][0] < 500 * NS_PER_MS
        decided = fleet.journal.list_decisions(report.job_id)
        assert len({step for step, _ in decided}) == len(decided)

    run_fleet(main)


@pytest.mark.parametrize("times", [1, 3])
def test_a_step_whose_answer_is_lost_runs_once(times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    lost: list[str] = []
    request_reply = MemberRequests._request_reply  # pyright: ignore[reportPrivateUsage]

    async def lose(self: MemberRequests, member: str, verb: str, *more: Any) -> Any:
        reply = await request_reply(self, member, verb, *more)
        if verb == "start-at-once" and len(lost) < times:
            lost.append(verb)
            raise RequestTimeout(verb)
        return reply

    monkeypatch.setattr(MemberRequests, "_request_reply", lose)

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        before = len(motions(fleet, "stage", "1"))
        report = await outcome(fleet, job(to_and_fro("stage.u", 4, 2)))
        assert report.state == "done" and len(lost) == times
        assert len(motions(fleet, "stage", "1")) == before + 4
        require_decisions(fleet, report, "stage", "1")

    run_fleet(main)


def test_without_a_decision_in_the_journal_nothing_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise JournalError("the disk is full", "make room")

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        before = len(motions(fleet, "stage", "1"))
        monkeypatch.setattr(SqliteJournal, "record_decision", refuse)
        client = fleet.make_client()
        await client.start_queue()
        job_id = await client.submit(job(to_and_fro("stage.u", 4, 1)))
        await sleep_ns(fleet.clock, 5 * NS_PER_S)
        assert len(motions(fleet, "stage", "1")) == before
        assert job_id

    run_fleet(main)


@pytest.mark.parametrize("process", ["host/local", "coordinator/first"])
@pytest.mark.parametrize("delay_ms", [0, *(pytest.param(delay_ms, marks=pytest.mark.nightly) for delay_ms in (30, 60))])
def test_a_process_that_dies_while_a_step_waits_starts_nothing_twice(process: str, delay_ms: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        counts = len(motions(fleet, "stage", "1"))
        await submit_pair(fleet, delay_ms)
        fleet.kill(process)
        await sleep_ns(fleet.clock, 4 * NS_PER_S)
        assert len(motions(fleet, "stage", "1")) <= counts + 2
        assert not is_moving(fleet)

    run_fleet(main)
