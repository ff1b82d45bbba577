"""Jobs that have ended on their way go on from the place where they stood: paths, scans, programs, other steps."""

import asyncio
from collections.abc import Awaitable, Callable
from math import hypot
from pathlib import Path

import pytest
from cluster.worlds import PREPARE, job, outcome, run_fleet, wait_for_point

from orchestrator.client.api import Tutti
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.files import FileError
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.rest import JobRest
from orchestrator.model.report import JobReport
from orchestrator.model.steps.path import FollowPath
from orchestrator.runtime.virtual.fleet import VirtualFleet

SQUARE = (
    "{do: path, axes: [gantry.x, gantry.y], start: [0, 0], tolerance: 100 um, speed: 10 mm/s, pieces: ["
    "{piece: line, to: [20, 0]}, {piece: arc, to: [20, 20], centre: [20, 10]}, {piece: line, to: [0, 20]}]}"
)
LAMP = "{do: output, output: gantry.lamp, value: true}"


async def stop_at(
    fleet: VirtualFleet, stopped: Job, is_there: Callable[[float, float], bool], verb: str = "estop"
) -> tuple[str, JobReport]:
    """Run a job until the gantry is there, and end it; its id and report, and everything is ready again."""
    client = fleet.make_client()
    await client.start_queue()
    job_id = await client.submit(stopped)
    while not is_there(await client.position("gantry.x"), await client.position("gantry.y")):
        await asyncio.sleep(0.02)
    await (client.estop() if verb == "estop" else client.cancel_job(job_id))
    report = await client.wait_for_job(job_id)
    await asyncio.sleep(1)
    if verb == "estop":
        await client.reset()
        await asyncio.sleep(1)
    return job_id, report


async def go_on(client: Tutti, rest: JobRest) -> JobReport:
    """Take the axes back, and run the rest."""
    if rest.move is not None:
        await client.run(rest.move)
    await client.start_queue()
    return await client.wait_for_job(await client.continue_job(rest))


def with_fleet(main: Callable[[VirtualFleet, Tutti], Awaitable[None]]) -> None:
    async def run(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        await main(fleet, fleet.make_client())

    run_fleet(run)


def first_path(rest: JobRest) -> FollowPath:
    assert rest.job is not None
    return next(step for step in rest.job.steps if isinstance(step, FollowPath))


def test_a_path_goes_on_from_the_place_where_it_stood() -> None:
    async def main(fleet: VirtualFleet, client: Tutti) -> None:
        job_id, report = await stop_at(
            fleet, job(f"[{LAMP}, {SQUARE}, {{do: dwell, duration: 1 ms}}]"), lambda x, _: x > 25
        )
        assert report.state == "aborted"
        await outcome(fleet, PREPARE)  # the axes are somewhere else then
        rest = await client.find_rest(job_id)
        assert (rest.step, rest.piece, rest.is_recorded) == (1, 2, True)
        assert rest.place.startswith("step 2 (path), piece 2 of 3")
        x, y = (way.to for way in rest.way)
        assert hypot(x - 20, y - 10) == pytest.approx(10, abs=1e-6) and x > 24
        assert [way.here for way in rest.way] == [pytest.approx(0, abs=0.01)] * 2
        assert rest.outputs == {"gantry.lamp": True}
        assert rest.job is not None and [step.kind for step in rest.job.steps] == ["output", "path", "dwell"]
        assert [piece.piece for piece in first_path(rest).pieces] == ["arc", "line"]
        done = await go_on(client, rest)
        assert done.state == "done", done.reason
        assert done.name == "rest of test"
        assert await client.position("gantry.y") == pytest.approx(20, abs=0.01)
        entry = (await client.show_job(done.job_id)).entry
        assert entry is not None and entry.terms.continues == job_id
        with pytest.raises(Refusal, match="is done"):
            await client.find_rest(done.job_id)
        assert (await client.find_rest(job_id)).confirm == [f"job {done.job_id} goes on with it already, and is done"]

    with_fleet(main)


def test_a_rest_is_continued_once_more() -> None:
    async def main(fleet: VirtualFleet, client: Tutti) -> None:
        job_id, _ = await stop_at(fleet, job(f"[{SQUARE}]"), lambda x, _: x > 8)
        rest = await client.find_rest(job_id)
        assert rest.piece == 1 and first_path(rest).start != [0, 0]
        if rest.move is not None:
            await client.run(rest.move)
        assert rest.job is not None
        again_id, _ = await stop_at(fleet, rest.job, lambda _, y: y > 18)
        rest = await client.find_rest(again_id)
        assert rest.piece in (2, 3) and rest.job is not None and rest.job.name == "rest of test"
        assert (await go_on(client, rest)).state == "done"

    with_fleet(main)


def test_a_path_whose_zero_has_changed_is_not_continued() -> None:
    async def main(fleet: VirtualFleet, client: Tutti) -> None:
        job_id, _ = await stop_at(fleet, job(f"[{SQUARE}]"), lambda x, _: x > 8)
        await outcome(fleet, PREPARE, job("[{do: set-position, axes: {gantry.y: 2}}]"))
        with pytest.raises(Refusal, match=r"the zero of gantry\.y has changed since the job ran, by 2 mm"):
            await client.find_rest(job_id)

    with_fleet(main)


def test_a_cancelled_path_goes_on_by_where_its_axes_are() -> None:
    async def main(fleet: VirtualFleet, client: Tutti) -> None:
        job_id, report = await stop_at(fleet, job(f"[{SQUARE}]"), lambda x, _: x > 8, "cancel")
        assert report.steps == []
        rest = await client.find_rest(job_id)
        assert (rest.piece, rest.is_recorded) == (1, False) and "by where the axes are now" in rest.place
        assert (await go_on(client, rest)).state == "done"

    with_fleet(main)


def test_a_scan_goes_on_with_its_point() -> None:
    async def main(fleet: VirtualFleet, client: Tutti) -> None:
        scan = "{do: scan, axes: {gantry.x: {from: 0, to: 40, points: 5}}, at_each: [{do: dwell, duration: 500 ms}]}"
        await client.start_queue()
        job_id = await client.submit(job(f"[{LAMP}, {scan}, {{do: dwell, duration: 1 ms}}]"))
        await wait_for_point(fleet, job_id, 3)
        await client.estop()
        await client.wait_for_job(job_id)
        await asyncio.sleep(1)
        await client.reset()
        await outcome(fleet, PREPARE, job("[{do: output, output: gantry.lamp, value: false}]"))
        rest = await client.find_rest(job_id)
        assert (rest.point, rest.job, rest.outputs) == (3, None, {"gantry.lamp": True})
        assert [(way.axis, way.to) for way in rest.way] == [("gantry.x", 20)]
        done = await go_on(client, rest)
        assert done.state == "done", done.reason
        assert done.steps[0].scan is not None and done.steps[0].scan.done == 3
        entry = (await client.show_job(done.job_id)).entry
        assert entry is not None and (entry.terms.continues, entry.origin) == (job_id, job_id)
        assert (await client.status())["gantry"].outputs["lamp"]

    with_fleet(main)


PROGRAM = "G21 G90 F600\nG1 X20 Y0\nG1 X20 Y20\nG1 X0 Y20\nM30\n"


def test_a_program_of_a_step_goes_on_if_its_file_is_as_it_was(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet, client: Tutti) -> None:
        path = tmp_path / "part.ngc"
        path.write_text(PROGRAM)
        step = f"{{do: path, file: '{path}', axes: {{X: gantry.x, Y: gantry.y}}, tolerance: 100 um}}"
        job_id, _ = await stop_at(fleet, job(f"[{step}]"), lambda _, y: y > 5)
        with pytest.raises(Refusal, match=r"was made of the file 'part\.ngc', which is compared") as needs:
            await client.find_rest(job_id)
        assert needs.value.remedy == f"give it: `tutti job continue {job_id} part.ngc`"
        path.write_text(PROGRAM.replace("X20 Y20", "X20 Y21"))
        with pytest.raises(FileError, match=r"the text is not that of 'part\.ngc' as it ran"):
            await client.find_rest(job_id, path)
        path.write_text(PROGRAM)
        rest = await client.find_rest(job_id, path)
        assert (rest.piece, rest.line) == (2, 3) and "line 3 of part.ngc" in rest.place
        done = await go_on(client, rest)
        assert done.state == "done", done.reason
        shown = (await client.show_job(done.job_id)).job
        assert shown is not None and isinstance(shown.steps[0], FollowPath) and shown.steps[0].source is not None
        assert [shown.steps[0].source.find_line(piece) for piece in (0, 1, 2)] == [3, 4, None]

    with_fleet(main)


def test_what_cannot_be_continued_is_refused_with_a_way_out() -> None:
    async def main(fleet: VirtualFleet, client: Tutti) -> None:
        by = "{do: move, by: {gantry.x: 60}, speed: 0.05}"
        job_id, _ = await stop_at(fleet, job(f"[{by}]"), lambda x, _: x > 2)
        with pytest.raises(Refusal, match=r"depends on where gantry\.x stood") as relative:
            await client.find_rest(job_id)
        assert "tutti job retry" in relative.value.remedy
        with pytest.raises(Refusal, match="was not made of a file"):
            await client.find_rest(job_id, __file__)
        to = "{do: move, to: {gantry.x: 60}, speed: 0.05}"
        job_id, _ = await stop_at(fleet, job(f"[{to}]"), lambda x, _: 5 < x < 40)
        rest = await client.find_rest(job_id)
        assert [(way.axis, way.to) for way in rest.way] == [("gantry.x", 60)]
        assert (await go_on(client, rest)).state == "done"

    with_fleet(main)


def test_the_line_that_runs_is_in_the_progress(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet, client: Tutti) -> None:
        path = tmp_path / "part.ngc"
        path.write_text("G21 G90 F600\nG1 X20 Y0\n(corner)\nG1 X20 Y10\nG2 X40 Y10 I10 J0\nM30\n")
        step = f"{{do: path, file: '{path}', axes: {{X: gantry.x, Y: gantry.y}}, tolerance: 100 um}}"
        await client.start_queue()
        job_id = await client.submit(job(f"[{step}]"))
        seen: list[tuple[int | None, float, float]] = []
        while (await client.show_job(job_id)).report is None:
            progress = (await client.show_job(job_id)).progress
            if progress is not None and progress.line is not None:
                axes = await client.axes()
                seen.append((progress.line, axes["gantry.x"].position, axes["gantry.y"].position))
            await asyncio.sleep(0.1)
        assert list(dict.fromkeys(line for line, _, _ in seen)) == [2, 4, 5]
        for line, x, y in seen:  # as old as a poll, and as the progress
            assert (
                (line == 2 and x < 20.1 and y < 3) or (line == 4 and y < 10.1 and 17 < x < 22) or (line == 5 and y > 7)
            )

    with_fleet(main)


def test_the_line_stays_while_its_path_is_held(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet, client: Tutti) -> None:
        path = tmp_path / "part.ngc"
        path.write_text("G21 G90 F600\nG1 X20 Y0\nG1 X20 Y10\n")
        step = f"{{do: path, file: '{path}', axes: {{X: gantry.x, Y: gantry.y}}, tolerance: 100 um}}"
        await client.start_queue()
        job_id = await client.submit(job(f"[{step}]"))
        while await client.position("gantry.y") < 4:
            await asyncio.sleep(0.02)
        await client.pause_job(job_id, now=True)
        await asyncio.sleep(3)
        progress = (await client.show_job(job_id)).progress
        assert progress is not None and (progress.state, progress.line) == ("paused", 3)
        await client.estop()
        await client.wait_for_job(job_id)
        await asyncio.sleep(1)
        await client.reset()
        await asyncio.sleep(1)
        rest = await client.find_rest(job_id, path)
        assert (rest.piece, rest.line) == (2, 3)
        assert (await go_on(client, rest)).state == "done"

    with_fleet(main)
