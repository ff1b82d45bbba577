"""Verbs of scripts, and what they return, on a virtual fleet."""

import asyncio
import math
from pathlib import Path

import pytest
from cluster.worlds import MOVE, PREPARE, job, outcome, run_fleet

from orchestrator.bus.base import Priority
from orchestrator.model.errors import Refusal
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import JobProgress
from orchestrator.runtime.virtual.fleet import VirtualFleet
from tutti import JobFailed, Move, Tutti

LONG = {"gantry.x": 300.0, "stage.u": 12.0}


async def prepare(fleet: VirtualFleet) -> Tutti:
    tutti = fleet.make_client("script")
    await tutti.enable("gantry", "stage")
    await tutti.home()
    return tutti


def test_a_script_moves_axes_and_reads_where_they_are() -> None:
    async def main(fleet: VirtualFleet) -> None:
        tutti = await prepare(fleet)
        report = await tutti.move({"gantry.x": 20, "stage.u": "1.5 mm"}, speed=0.5)
        assert report.state == "done" and [step.verdict for step in report.steps] == ["green"]
        assert await tutti.position("gantry.x") == pytest.approx(20, abs=0.01)
        assert await tutti.position("stage.u") == pytest.approx(1.5, abs=0.01)
        await tutti.move(by={"gantry.x": -5})
        assert (await tutti.axes())["gantry.x"].position == pytest.approx(15, abs=0.01)
        await tutti.set_position({"gantry.x": 0})
        await tutti.run([Move(to={"gantry.x": 1}, speed={"gantry.x": "50 mm/s"}), Move(to={"gantry.x": 0})])
        assert await tutti.position("gantry.x") == pytest.approx(0, abs=0.01)
        await tutti.disable("stage")
        assert not (await tutti.axes())["stage.u"].enabled

    run_fleet(main)


@pytest.mark.parametrize(
    ("axis", "code"), [("gantry.q", "unknown-axis"), ("nothing.x", "unknown-axis"), ("gantry", "unknown-axis")]
)
def test_an_axis_that_does_not_exist_is_refused_with_those_that_do(axis: str, code: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        with pytest.raises(Refusal, match=r"gantry\.x, gantry\.y") as refused:
            await fleet.make_client().position(axis)
        assert refused.value.code == code

    run_fleet(main)


def test_what_cannot_begin_is_refused_and_what_fails_has_its_report() -> None:
    async def main(fleet: VirtualFleet) -> None:
        tutti = fleet.make_client("script")
        with pytest.raises(Refusal, match="not enabled"):
            await tutti.move({"gantry.x": 1})
        await prepare(fleet)
        moving = asyncio.ensure_future(tutti.move(LONG, speed=0.1))
        await fleet.wait_until(lambda states: states["gantry"].axes["x"].moving)
        fleet.act_on_controller("gantry", lambda unit: unit.set_limit("X", "both"))
        with pytest.raises(JobFailed) as failed:
            await moving
        assert failed.value.report.state == "failed" and failed.value.report.reason in str(failed.value)

    run_fleet(main)


def test_an_interrupted_call_stops_what_it_has_begun_and_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    async def main(fleet: VirtualFleet) -> None:
        tutti = await prepare(fleet)
        moving = asyncio.ensure_future(tutti.move(LONG, speed=0.1))
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        begun_ns = fleet.clock.now_ns()
        moving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await moving
        assert all(unit.at_rest() for unit in fleet.controllers.values())
        assert fleet.clock.now_ns() - begun_ns < 3_000_000_000
        assert await tutti.position("gantry.x") < 299

    run_fleet(main)
    assert "interrupted: move is cancelled" in capsys.readouterr().err


def test_a_call_that_is_interrupted_while_it_is_submitted_begins_nothing() -> None:
    async def main(fleet: VirtualFleet) -> None:
        tutti = await prepare(fleet)
        for pause_s in (0.0, 0.0005, 0.001, 0.002, 0.005):
            moving = asyncio.ensure_future(tutti.move(LONG, speed=0.1))
            await asyncio.sleep(pause_s)
            moving.cancel()
            await asyncio.gather(moving, return_exceptions=True)
            await asyncio.sleep(2.0)
            assert all(unit.at_rest() for unit in fleet.controllers.values())
        assert await tutti.position("gantry.x") == pytest.approx(0, abs=5)

    run_fleet(main)


def test_positions_come_at_their_rate_and_are_not_a_number_while_unknown() -> None:
    async def main(fleet: VirtualFleet) -> None:
        tutti = await prepare(fleet)
        moving = asyncio.ensure_future(tutti.move({"gantry.x": 60}, speed=0.2))
        begun_ns, seen = fleet.clock.now_ns(), list[float]()
        async for now in tutti.positions(["gantry.x"], hz=20):
            seen.append(now["gantry.x"])
            if len(seen) == 40:
                break
        assert (fleet.clock.now_ns() - begun_ns) / 1e9 == pytest.approx(2.0, abs=0.2)
        assert seen == sorted(seen) and seen[-1] > 10
        await moving
        fleet.wires["gantry"].cut = True
        await fleet.wait_until(lambda states: states["gantry"].mode == "offline")
        async for now in tutti.positions():
            assert math.isnan(now["gantry.x"]) and not math.isnan(now["stage.u"])
            break
        with pytest.raises(Refusal, match="no axis"):
            async for _ in tutti.positions(["gantry.q"]):
                pass

    run_fleet(main)


def test_events_of_the_fleet_come_as_they_are() -> None:
    async def main(fleet: VirtualFleet) -> None:
        tutti = await prepare(fleet)
        kinds: list[str] = []

        async def follow() -> None:
            async for event in tutti.events("gantry"):
                kinds.append(event.kind)

        following = asyncio.ensure_future(follow())
        await asyncio.sleep(0.1)
        tutti.bus.put(tutti.keys.event("gantry"), b"garbage", Priority.EVENT)
        await tutti.move({"gantry.x": 5, "stage.u": 1})
        following.cancel()
        assert {"started", "done"} <= set(kinds)

    run_fleet(main)


def test_what_a_callback_raises_reaches_the_caller() -> None:
    async def main(fleet: VirtualFleet) -> None:
        tutti = await prepare(fleet)
        await tutti.start_queue()

        def fail(progress: JobProgress) -> None:
            raise ZeroDivisionError(progress.state)

        with pytest.raises(ZeroDivisionError):
            await tutti.wait_for_job(await tutti.submit(MOVE), fail)

    run_fleet(main)


def test_lists_states_and_reports_print_as_tables(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        tutti = fleet.make_client("script")
        assert (await outcome(fleet, PREPARE)).state == "done"
        submitted = await tutti.submit(
            job("[{do: move, to: {gantry.x: 10, stage.u: 1}}, {do: move, to: {gantry.x: 0}}]")
        )
        report = await submitted.result()
        await tutti.submit(MOVE, terms=QueueTerms(held=True))
        queue = await tutti.list_jobs()
        assert [entry.state for entry in queue] == ["queued", "done", "done"] and len(queue) == 3
        assert queue[1].id == submitted.id
        for shown, words in ((queue, "held by"), (report, "verdict green"), (await tutti.status(), "stage")):
            assert words in str(shown)
            html = shown._repr_html_()  # pyright: ignore[reportPrivateUsage]
            assert html.startswith("<pre") and words.split()[0] in html
        report.plot(tmp_path / "scan.png")
        assert (tmp_path / "scan.png").read_bytes().startswith(b"\x89PNG")
        assert [each.step for each in report.recordings] == [0, 1]
        with pytest.raises(Refusal, match="no recording"):
            (await tutti.dwell(0.1)).plot()

    run_fleet(main)
