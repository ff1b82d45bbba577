"""Live jobs: a program asks for moves while its job runs."""

import asyncio

import pytest
from cluster.worlds import EXAMPLES

from tutti import Refusal, Tutti
from tutti.testing import virtual_fleet

DEMO = EXAMPLES / "demo.fleet.yaml"


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
        fleet.tutti.enable()
        fleet.tutti.home()
        fleet.run(main)


def test_submitted_moves_are_chained() -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live("gantry.x", speed=1.0) as live:
            numbers = await live.submit(*(live.make_move({"gantry.x": x}) for x in (10, 20, 30, 40)))
            assert numbers == [0, 1, 2, 3]
            reports = [await live.wait_for(number) for number in numbers]
            assert [report.chain is not None and report.chain.kept for report in reports] == [False, True, True, True]

    with virtual_fleet(DEMO) as fleet:
        fleet.tutti.enable()
        fleet.tutti.home()
        fleet.run(main)


def test_gathered_moves_are_one_step() -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live("gantry", gather="20 ms", speed=1.0) as live:
            x, y = await asyncio.gather(live.move({"gantry.x": 30}), live.move({"gantry.y": 20}))
            assert x.index == y.index and set(x.positions) == {"gantry.x", "gantry.y"}

    with virtual_fleet(DEMO) as fleet:
        fleet.tutti.enable()
        fleet.tutti.home()
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
        fleet.tutti.enable()
        fleet.tutti.home()
        fleet.run(main)
