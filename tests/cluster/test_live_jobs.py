"""Live jobs: a program asks for moves while its job runs."""

import asyncio
import statistics
from collections.abc import Iterable
from contextlib import suppress

import pytest
from cluster.worlds import EXAMPLES

from orchestrator.model.jobs.service import JobReference
from orchestrator.model.messages import Reply
from tutti import (
    Dwell,
    FollowPath,
    Job,
    JobFailed,
    Live,
    Move,
    Refusal,
    Repeat,
    Scan,
    StepFailed,
    Tutti,
    WrongValue,
)
from tutti.testing import VirtualTestbed, virtual_fleet

DEMO = EXAMPLES / "demo.fleet.yaml"


def prepare(fleet: VirtualTestbed) -> None:
    """Enable and home all axes."""
    fleet.tutti.enable()
    fleet.tutti.home()


def test_moves_of_a_program_are_one_job_with_a_row_each() -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live(["gantry", "stage.u"], name="alignment", speed=1.0) as live:
            for x in (10, 20, 15):
                report = await live.move({"gantry.x": x, "stage.u": x / 10})
                assert report.state == "done" and report.positions["gantry.x"].position == pytest.approx(x, abs=0.01)
        assert live.result is not None
        (step,) = live.result.steps
        assert (live.result.name, step.do, step.state) == ("alignment", "live", "done")
        assert step.scan is not None and (step.scan.points, step.scan.done) == (3, 3)
        assert [row.target["gantry.x"] for row in live.result.points] == [10, 20, 15]

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)


def test_submitted_moves_are_chained() -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live("gantry.x", speed=1.0) as live:
            numbers = await live.submit(*(live.make_move({"gantry.x": x}) for x in (10, 20, 30, 40)))
            assert numbers == [0, 1, 2, 3]
            reports = [await live.wait_for(number) for number in numbers]
            assert [report.chain is not None and report.chain.kept for report in reports] == [False, True, True, True]

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)


def test_gathered_moves_are_one_step() -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live("gantry", gather="20 ms", speed=1.0) as live:
            x, y = await asyncio.gather(live.move({"gantry.x": 30}), live.move({"gantry.y": 20}))
            assert x.index == y.index and set(x.positions) == {"gantry.x", "gantry.y"}

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)


def test_a_refused_move_leaves_the_live_job() -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live("gantry.x", speed=1.0) as live:
            with pytest.raises(Refusal, match=r"stage\.u is not of this live job"):
                await live.move({"stage.u": 1})
            with pytest.raises(Refusal) as caught:
                await live.move({"gantry.x": 1e6})
            assert caught.value.code == "soft-limit"
            with pytest.raises(Refusal, match="at most 100 may wait"):
                await live.submit(*(live.make_move({"gantry.x": 1}) for _ in range(101)))
            assert (await live.move({"gantry.x": 5})).state == "done"
        with pytest.raises(Refusal, match="has ended"):
            await live.move({"gantry.x": 5})

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)


def test_gaps_are_those_of_a_scan_and_of_single_steps() -> None:
    """Of one SMC-4000: moves that were asked for ahead follow each other as points of a scan do; one that is asked for
    when the one before it is done begins 65 ms later at the latest, by evidence."""
    points = [2.0 * (number % 10 + 1) for number in range(40)]

    async def main(tutti: Tutti) -> tuple[float, float, list[float]]:
        rows = [[point] for point in points]
        result = await tutti.run(Scan(points={"axes": ["gantry.x"], "rows": rows}, speed=1.0))
        scanned = find_mean_ns(point.t0_fleet_ns for point in result.points)
        async with tutti.live("gantry.x", speed=1.0) as live:
            numbers = await live.submit(*(live.make_move({"gantry.x": point}) for point in points))
            reports = [await live.wait_for(number) for number in numbers]
            asked = find_mean_ns(report.t0_fleet_ns for report in reports)
            awaited = [await live.move({"gantry.x": point}) for point in points]
        return scanned, asked, [report.chain.gap_s or 0.0 for report in awaited[1:] if report.chain is not None]

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        scanned_ns, asked_ns, gaps_s = fleet.run(main)
        assert asked_ns <= 1.2 * scanned_ns
        assert 0 < statistics.median(gaps_s) <= 0.065


def find_mean_ns(instants: Iterable[int | None]) -> float:
    """The mean time from instant to instant."""
    known = [instant for instant in instants if instant is not None]
    return (known[-1] - known[0]) / (len(known) - 1)


def test_all_that_a_live_job_takes() -> None:
    async def main(tutti: Tutti) -> None:
        path = FollowPath(
            axes=["gantry.x", "gantry.y"],
            start=[5, 5],
            tolerance="0.1 mm",
            speed="20 mm/s",
            pieces=[{"piece": "line", "to": [10, 10]}],
        )
        async with tutti.live(["gantry", "stage.u"], speed=1.0) as live:
            assert (await live.enable()).state == "done"
            assert (await live.home()).state == "done"
            await live.move({"gantry.x": 5, "gantry.y": 5})
            assert (await live.path(path)).state == "done"
            assert (await live.output("gantry.lamp", pulse_s=0.1)).state == "done"
            assert (await live.dwell(0.2)).state == "done"
            with pytest.raises(Refusal, match="did not become active"):
                await live.wait_input("gantry.door", timeout_s=0.1)
            assert (await live.move(by={"gantry.x": -1})).positions["gantry.x"].position == pytest.approx(9, abs=0.01)
        assert live.result is not None and live.result.state == "done"

    with virtual_fleet(DEMO) as fleet:
        fleet.run(main)


def test_a_move_that_is_stopped_leaves_the_live_job_and_those_behind_it_do_not_begin() -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live("gantry.x", speed=0.2) as live:
            far, behind = await live.submit(live.make_move({"gantry.x": 300}), live.make_move({"gantry.x": 5}))
            await asyncio.sleep(1.5)
            task = asyncio.create_task(live.wait_for(far))
            await live.stop()
            with pytest.raises(StepFailed) as caught:
                await task
            assert caught.value.report.state == "stopped"
            with pytest.raises(StepFailed, match="skipped: stopped by"):
                await live.wait_for(behind)
            task = asyncio.create_task(live.move({"gantry.x": 300}))
            await asyncio.sleep(1.0)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            report = await live.move({"gantry.x": 20})
            assert report.positions["gantry.x"].position == pytest.approx(20, abs=0.01)
        assert live.result is not None and live.result.state == "done"
        assert [point.state for point in live.result.points] == ["stopped", "stopped", "done"]

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)


def test_moves_behind_one_that_is_refused_do_not_begin() -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live("gantry.x", speed=1.0) as live:
            await live.move({"gantry.x": 10})
            # By distances the limit is met only when its turn comes.
            bad, behind = await live.submit(live.make_move(by={"gantry.x": 395}), live.make_move(by={"gantry.x": -1}))
            with pytest.raises(Refusal, match="limit"):
                await live.wait_for(bad)
            with pytest.raises(StepFailed, match="move 2 before it was not done"):
                await live.wait_for(behind)
            assert (await live.move({"gantry.x": 11})).state == "done"

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)


@pytest.mark.parametrize("moving", [True, False])
def test_an_estop_ends_it(moving: bool) -> None:
    async def main(tutti: Tutti) -> JobFailed:
        with pytest.raises(JobFailed) as caught:
            async with tutti.live("gantry.x", speed=0.2) as live:
                numbers = await live.submit(live.make_move({"gantry.x": 300})) if moving else [0]
                await asyncio.sleep(1.0)
                await tutti.estop("test")
                with suppress(StepFailed):  # the step, if one was moving; then the job
                    await live.wait_for(numbers[0])
                await live.move({"gantry.x": 1})
        return caught.value

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        failure = fleet.run(main)
        assert failure.report.state == "aborted" and "e-stop" in failure.report.reason
        fleet.advance("2 s")
        rest = fleet.truth("gantry.x").position_at(fleet.now_s)
        fleet.tutti.reset()
        fleet.advance("3 s")
        assert fleet.truth("gantry.x").position_at(fleet.now_s) == rest, "nothing begins by itself"


def test_a_program_that_is_suspended_loses_its_live_job_within_a_second() -> None:
    async def main(tutti: Tutti) -> float:
        live = tutti.live("gantry.x", speed=0.2)
        await live.begin()
        (number,) = await live.submit(live.make_move({"gantry.x": 300}))
        await asyncio.sleep(1.0)
        suspended_s = asyncio.get_running_loop().time()
        await live._attendance.__aexit__()  # no sign of life any more
        with pytest.raises(StepFailed, match="has ended"):
            await live.wait_for(number)
        rested_s = asyncio.get_running_loop().time() - suspended_s
        with pytest.raises(JobFailed, match="has ended"):
            await live.move({"gantry.x": 300})
        return rested_s

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        assert 0.9 < fleet.run(main) < 2.5
        assert 0 < fleet.truth("gantry.x").position_at(fleet.now_s) < 200


def test_an_error_of_the_program_ends_it_and_it_cannot_be_used_again() -> None:
    async def main(tutti: Tutti) -> None:
        live = tutti.live("gantry.x", speed=0.2)
        with pytest.raises(Refusal, match="was not begun"):
            await live.move({"gantry.x": 1})
        with pytest.raises(ZeroDivisionError):
            async with live:
                await live.submit(live.make_move({"gantry.x": 300}))
                await asyncio.sleep(1.0)
                raise ZeroDivisionError
        assert live.result is not None and live.result.state == "cancelled"
        with pytest.raises(JobFailed, match="cancelled"):
            await live.move({"gantry.x": 1})
        with pytest.raises(Refusal, match="was begun already"):
            await live.begin()

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)


def test_a_live_job_belongs_to_a_program() -> None:
    job = Job("live", [Live(axes=["gantry.x"])])

    async def main(tutti: Tutti) -> None:
        with pytest.raises(Refusal, match="ends with that program"):
            await tutti.submit(job)
        async with tutti.live("gantry.x") as live:
            with pytest.raises(Refusal, match="gantry is in use"):
                await tutti.move({"gantry.x": 1})
            async with asyncio.timeout(60):
                with pytest.raises(Refusal, match="in use"):
                    await tutti.live("gantry.y").begin()
        assert live.result is not None
        with pytest.raises(Refusal, match="its moves came from a program"):
            await tutti.retry_job(live.id)
        live = tutti.live("gantry.x")
        await live.begin()
        await tutti.cancel_job(live.id)
        with pytest.raises(JobFailed, match="is cancelled"):
            await live.move({"gantry.x": 1})
        with pytest.raises(Refusal, match="its moves came from a program"):
            await tutti.find_rest(live.id)
        done = await tutti.run(Move(to={"gantry.x": 2}))
        with pytest.raises(Refusal, match="is done already"):
            await tutti.request_service("end-live", JobReference(**tutti.request_fields(), job_id=done.job_id), Reply)

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)
    with pytest.raises(WrongValue, match="stands alone"):
        Job("two", [Live(axes=["gantry.x"]), Dwell(duration="1 s")])
    with pytest.raises(WrongValue, match="cannot be repeated"):
        Job("again", [Repeat(times=2, steps=[Live(axes=["gantry.x"])])])


def test_it_is_paused_and_resumed() -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live("gantry.x", speed=0.5) as live:
            (number,) = await live.submit(live.make_move({"gantry.x": 100}))
            await asyncio.sleep(0.6)
            await tutti.pause_job(live.id, now=True)
            await asyncio.sleep(3)
            assert (await tutti.show_job(live.id)).progress.state == "paused"
            await tutti.resume_job(live.id)
            assert (await live.wait_for(number)).state == "done"

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)


def test_the_blocking_form() -> None:
    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        with fleet.tutti.live(["gantry.x"], name="by hand", speed=1.0) as live:
            live.move({"gantry.x": 4})
            assert live.move(by={"gantry.x": 1}).state == "done"
        assert live.result is not None and live.result.steps[0].scan is not None
        assert live.result.steps[0].scan.done == 2
