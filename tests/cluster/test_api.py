"""The Python API as programs use it: a job is followed from its submission to its report."""

import asyncio
import traceback
from pathlib import Path

import pytest
from cluster.worlds import PREPARE, job, run_fleet

from orchestrator.client import Tutti
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.files import FileError
from orchestrator.model.report import JobProgress, JobTransition
from orchestrator.model.templates.template import Template
from orchestrator.runtime.virtual.fleet import VirtualFleet

MOVE = job("[{do: move, to: {gantry.x: 60}, speed: 0.2}, {do: dwell, duration: 0.5 s}]")
LIFE = ["queued", "planning", "arming", "committed", "running"]


def test_a_job_is_followed_by_each_change_of_its_state_once_and_by_its_progress() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await client.wait_for_job(await client.submit(PREPARE))
        submitted = await client.submit(MOVE)
        changes: list[JobTransition] = []
        progress: list[JobProgress] = []
        async for event in submitted.events():
            (changes if isinstance(event, JobTransition) else progress).append(event)  # type: ignore[arg-type]
        report = await submitted.result()
        assert report.state == "done" and report.job_id == submitted == submitted.id
        assert [each.state for each in changes][:5] == LIFE
        assert changes[-1].state == "done"
        assert changes == (await submitted.show()).transitions
        moving = [each.fraction for each in progress if each.state == "running"]
        assert len(moving) > 3 and moving == sorted(moving)

    run_fleet(main)


def test_a_template_is_submitted_with_its_parameters_and_a_retry_keeps_them(tmp_path: Path) -> None:
    path = tmp_path / "wait.job.yaml"
    path.write_text(
        "schema: tutti.job/1\nname: wait ${label}\n"
        "parameters: {time: {type: duration, max: 1 s}, label: {type: text, default: a}}\n"
        'steps: [{do: dwell, duration: "${time}"}]\n',
        encoding="utf-8",
    )

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        submitted = await client.submit(str(path), parameters={"time": "200 ms"})
        used = {"time": "200 ms", "label": "a"}
        report = await submitted.result()
        assert (report.state, report.name, report.parameters_used) == ("done", "wait a", used)
        shown = await submitted.show()
        assert shown.job is not None and shown.job.parameters_used == used
        again = await client.wait_for_job((await client.retry_job(submitted)).job_id)
        assert (again.state, again.parameters_used) == ("done", used)
        template = Template.load(path)
        assert (
            await (await client.submit(template, parameters={"time": "1 ms", "label": "b"})).result()
        ).name == "wait b"
        with pytest.raises(FileError, match=r"parameters: time: found '2 s'; must be at most 1 s"):
            await client.submit(template, parameters={"time": "2 s"})
        with pytest.raises(Refusal) as refused:
            await client.submit(template.fill(time="1 ms"), parameters={"time": "2 ms"})
        assert refused.value.code == "no-template"

    run_fleet(main)


def test_an_ended_job_is_read_from_the_journal_by_its_id_alone() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        job_id = (await client.submit(job("[{do: dwell, duration: 0.1 s}]"))).id
        await client.wait_for_job(job_id)
        seen = [event.state async for event in fleet.make_client("later").job(job_id).events()]
        assert seen[0] == "queued" and seen[-1] == "done"

    run_fleet(main)


def test_events_outlive_a_coordinator_and_lose_no_change() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await client.wait_for_job(await client.submit(PREPARE))
        submitted = await client.submit(MOVE)

        async def states() -> list[str]:
            return [event.state async for event in submitted.events() if isinstance(event, JobTransition)]

        listening = asyncio.ensure_future(states())
        await sleep_ns(fleet.clock, NS_PER_S)
        fleet.kill("coordinator/first")
        await sleep_ns(fleet.clock, NS_PER_S)
        fleet.start_coordinator("second")
        seen = await listening
        assert seen == [each.state for each in (await submitted.show()).transitions]
        assert seen[-1] == "interrupted"

    run_fleet(main)


def test_a_missing_job_and_a_closed_connection_are_named() -> None:
    async def main(fleet: VirtualFleet) -> None:
        with pytest.raises(Refusal) as refused:
            async for _ in fleet.make_client().job("none").events():
                pass
        assert refused.value.code == "unknown-job"

    run_fleet(main)
    with pytest.raises(RuntimeError, match="async with"):
        _ = Tutti("tcp/127.0.0.1:1").bus


def test_a_refusal_ends_in_the_code_of_the_script_with_at_most_two_frames_below_it() -> None:
    frames: list[list[str]] = []

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        for ask in (
            lambda: client.move({"gantry.x": 20}),
            lambda: client.submit(job("[{do: move, to: {gantry.q: 1}}]")),
            lambda: client.job("00000000").show(),
        ):
            try:
                await ask()
            except Refusal as refused:
                frames.append([frame.filename for frame in traceback.extract_tb(refused.__traceback__)])

    run_fleet(main)
    assert len(frames) == 3
    for files in frames:
        assert len([name for name in files if "/orchestrator/" in name]) <= 2, files


def test_what_submit_returns_prints_with_what_the_job_waits_for() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        await client.stop_queue()
        submitted = await client.submit(PREPARE)
        assert submitted.waits_for == "the queue is stopped (stopped by anna): `tutti queue start`"
        assert repr(submitted) == f"<SubmittedJob {PREPARE.name!r} {submitted.id} queued: {submitted.waits_for}>"
        assert f"{submitted}" == submitted.id
        assert client.job(submitted.id).waits_for == ""

    run_fleet(main)
