"""Recordings of fleets in virtual time: what is in them, and what disturbs a recorder."""

import asyncio
import errno
import io
import json
import os
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, BinaryIO

import pytest
from cluster.recordings import RecordedFleet, read_messages
from cluster.worlds import MOVE, PREPARE, demo_fleet, demo_job, job, run_fleet
from mcap.reader import make_reader

from orchestrator.bus.states.frame import FrameHeader, encode_frame
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.operation.recording import MessagesDropped, StepStart, WallClockStepped
from orchestrator.model.report import JobReport, StepRecording
from orchestrator.model.state import ControllerState
from orchestrator.monitor.recording.file import create_file
from orchestrator.monitor.recording.folder import RecorderLimits
from orchestrator.monitor.recording.reader import Recording, list_recordings, summarize_recording
from orchestrator.runtime.virtual.fleet import VirtualFleet

Body = Callable[[VirtualFleet, RecordedFleet, Tutti], Coroutine[Any, Any, None]]


def record_run(path: Path, body: Body, **options: Any) -> RecordedFleet:
    """Run `body` with a fleet that is recorded; return the recorder, which has ended."""

    async def main(virtual: VirtualFleet) -> RecordedFleet:
        recorded = RecordedFleet(virtual, path, **options)
        await recorded.recorder.start()
        running = asyncio.ensure_future(recorded.recorder.run())
        await body(virtual, recorded, virtual.make_client("anna"))
        running.cancel()
        await recorded.recorder.close()
        return recorded

    return run_fleet(main)


async def run_jobs(tutti: Tutti, *jobs: Any) -> list[JobReport]:
    return [await (await tutti.submit(each)).result() for each in jobs]


def test_a_job_has_a_recording_of_its_own_with_all_that_explains_it(tmp_path: Path) -> None:
    reports: list[JobReport] = []

    async def body(virtual: VirtualFleet, recorded: RecordedFleet, tutti: Tutti) -> None:
        reports.extend(await run_jobs(tutti, PREPARE, demo_job()))
        await asyncio.sleep(4)

    recorded = record_run(tmp_path, body)
    prepare, demo = [each for each in list_recordings(tmp_path) if each.job_id]
    assert (demo.job_id, demo.job_name, demo.fleet) == (reports[1].job_id, "demo", "demo")
    assert prepare.is_complete and demo.is_complete and demo.messages
    path = demo.path
    with Recording(path) as recording:
        attached = recording.read_attachments()
        assert recording.damage is None
    assert json.loads(attached["report.json"]) == json.loads(reports[1].to_json())
    assert json.loads(attached["job.json"])["name"] == "demo"
    assert set(json.loads(attached["clocks.json"])) == {"gantry"}
    keys = {each.key.replace(reports[1].job_id, "ID") for each in read_messages(path)}
    wanted = {"job/ID/begun", "job/ID/state", "job/ID/plan", "job/ID/report", "recorder/step-start"}
    assert keys >= wanted | {"ctl/gantry/state", "ctl/stage/state", "ctl/gantry/event", "ctl/stage/event"}
    plans = [
        StepRecording.model_validate_json(each.payload) for each in read_messages(path, lambda k: k.endswith("/plan"))
    ]
    moved = [each for each in reports[1].steps if each.t0_fleet_ns is not None]
    assert [(each.step, each.t0_fleet_ns) for each in plans] == [(each.index, each.t0_fleet_ns) for each in moved]
    # What belongs to a job is not in the recording of the fleet.
    rest = [each for path in recorded.files("fleet") for each in read_messages(path)]
    assert not {f"job/{reports[1].job_id}/{leaf}" for leaf in ("begun", "plan", "report")} & {each.key for each in rest}
    assert any(each.key == "queue" for each in rest)


def test_positions_of_all_axes_at_each_start_are_those_before_it(tmp_path: Path) -> None:
    steps = "[{do: move, to: {gantry.x: 20}}, {do: dwell, duration: 0.3 s}, {do: move, to: {gantry.x: 40, stage.u: 3}}]"
    reports: list[JobReport] = []

    async def body(virtual: VirtualFleet, recorded: RecordedFleet, tutti: Tutti) -> None:
        reports.extend(await run_jobs(tutti, PREPARE, job(steps)))
        await asyncio.sleep(4)

    path = record_run(tmp_path, body).files("job")[-1]
    messages = read_messages(path, lambda key: key == "recorder/step-start")
    starts = [StepStart.model_validate_json(each.payload) for each in messages]
    assert [each.step for each in starts] == [0, 1, 2]
    assert all(set(each.axes) == set(demo_fleet().axis_names) for each in starts)
    assert [round(each.axes["gantry.x"].position, 3) for each in starts] == [0, 20, 20]
    for start, step in zip(starts, reports[1].steps, strict=True):
        if start.start is None:
            assert step.do == "dwell"
            continue
        evidence = [each.start for member in step.members.values() for each in member.evidence.values()]
        assert start.start in evidence
        assert all(each.read_fleet_ns <= start.start.earliest_ns for each in start.axes.values() if each.read_fleet_ns)


def test_times_are_utc_of_fleet_time_and_the_publishers_instants(tmp_path: Path) -> None:
    async def body(virtual: VirtualFleet, recorded: RecordedFleet, tutti: Tutti) -> None:
        await asyncio.sleep(5)

    recorded = record_run(tmp_path, body)
    states = read_messages(recorded.files("fleet")[0], lambda key: key == "ctl/gantry/state")
    origin_ns = None
    for each in states[1:]:  # the first one came before the leader's scale
        state = ControllerState.model_validate_json(each.payload)
        assert state.read_fleet_ns is not None
        assert each.published_ns < each.received_ns < each.published_ns + NS_PER_S
        origin_ns = origin_ns or each.published_ns - state.read_fleet_ns
        assert each.published_ns - state.read_fleet_ns == origin_ns  # one scale, without error on the leader's kernel
    assert 4 <= len(states) <= 10  # at rest, one a second


def test_the_public_library_reads_our_files_by_their_index(tmp_path: Path) -> None:
    async def body(virtual: VirtualFleet, recorded: RecordedFleet, tutti: Tutti) -> None:
        await run_jobs(tutti, PREPARE)

    recorded = record_run(tmp_path, body)
    for path in (*recorded.files("job"), *recorded.files("fleet")):
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            assert summary is not None and summary.statistics is not None
            found = list(reader.iter_messages())
            assert len(found) == summary.statistics.message_count == len(read_messages(path))
            for schema, _, message in found:
                fields = json.loads(message.data)
                if schema is not None:
                    assert schema.encoding == "jsonschema"
                    required = json.loads(schema.data)["properties"]
                    assert set(fields) <= set(required)


# What disturbs a recorder


class FullDisk(io.FileIO):
    """A file on a disk that takes no data while `full` is set."""

    full = False

    def write(self, data: Any) -> int:
        if FullDisk.full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(data)


def open_on_full_disk(path: Path) -> BinaryIO:
    create_file(path).close()
    return io.BufferedWriter(FullDisk(path, "w"))  # pyright: ignore[reportReturnType]


def test_a_full_disk_ends_nothing_and_what_is_left_out_is_counted(tmp_path: Path) -> None:
    async def body(virtual: VirtualFleet, recorded: RecordedFleet, tutti: Tutti) -> None:
        await asyncio.sleep(3)
        FullDisk.full = True
        await asyncio.sleep(10)
        (raised,) = [each for each in await tutti.list_alarms() if each.kind == "recording"]
        assert raised.state == "unacknowledged" and "No space left on device; free space there" in raised.text
        FullDisk.full = False
        await asyncio.sleep(10)
        (returned,) = [each for each in await tutti.list_alarms() if each.kind == "recording"]
        assert returned.state == "returned"

    recorded = record_run(tmp_path, body, open_file=open_on_full_disk)
    assert recorded.alarms[0] == ("recording", True) and recorded.alarms[-1] == ("recording", False)
    before, after = recorded.files("fleet")[0], recorded.files("fleet")[-1]
    assert not summarize_recording(before).is_complete and summarize_recording(after).is_complete
    accounts = read_messages(after, lambda key: key == "recorder/dropped")
    noted = [MessagesDropped.model_validate_json(each.payload) for each in accounts]
    assert sum(each.total for each in noted) == recorded.writer.dropped > 0
    assert sum(noted[0].by_key.values()) == noted[0].total


def test_the_oldest_recordings_go_when_the_quota_is_used_up_and_never_one_that_is_written(tmp_path: Path) -> None:
    tmp_path.joinpath("job-20200101T000000Z-old-0.mcap").write_bytes(bytes(100_000))
    os.utime(tmp_path / "job-20200101T000000Z-old-0.mcap", (0, 0))
    quota = 260_000  # the file of the second job has 181 kB, those of the fleet 40 kB

    async def body(virtual: VirtualFleet, recorded: RecordedFleet, tutti: Tutti) -> None:
        await run_jobs(tutti, PREPARE)
        handle = await tutti.submit(MOVE)
        await handle.result()
        await asyncio.sleep(4)

    limits = RecorderLimits(quota=quota, rotate_ns=4 * NS_PER_S)
    recorded = record_run(tmp_path, body, limits=limits)
    assert not tmp_path.joinpath("job-20200101T000000Z-old-0.mcap").exists()
    assert any(summarize_recording(each).job_name == "test" for each in recorded.files("job"))
    assert sum(each.stat().st_size for each in tmp_path.glob("*.mcap")) < quota + 100_000


def test_a_running_job_that_uses_up_the_quota_keeps_its_events(tmp_path: Path) -> None:
    reports: list[JobReport] = []

    async def body(virtual: VirtualFleet, recorded: RecordedFleet, tutti: Tutti) -> None:
        reports.extend(await run_jobs(tutti, PREPARE, MOVE))
        await asyncio.sleep(4)

    recorded = record_run(tmp_path, body, limits=RecorderLimits(quota=60_000))
    assert ("recording-quota", True) in recorded.alarms
    last = recorded.files("job")[-1]
    assert summarize_recording(last).job_id == reports[-1].job_id
    kinds = [json.loads(each.payload)["kind"] for each in read_messages(last, lambda key: key.endswith("/event"))]
    assert kinds.count("started") == kinds.count("done") == 2
    assert recorded.writer.dropped > 0


def test_a_wall_clock_that_is_set_by_a_day_begins_another_file(tmp_path: Path) -> None:
    async def body(virtual: VirtualFleet, recorded: RecordedFleet, tutti: Tutti) -> None:
        await asyncio.sleep(3)
        virtual.clock.wall_step_ns = 86_400 * NS_PER_S
        await asyncio.sleep(3)

    recorded = record_run(tmp_path, body)
    first, second = recorded.files("fleet")
    note = read_messages(first, lambda key: key == "recorder/clock-stepped")
    assert abs(WallClockStepped.model_validate_json(note[0].payload).by_ns - 86_400 * NS_PER_S) < NS_PER_S
    times = [each.received_ns for each in read_messages(first)]
    assert times == sorted(times) and times[-1] - times[0] < 10 * NS_PER_S
    assert read_messages(second)[0].received_ns - times[-1] > 86_000 * NS_PER_S


def test_a_payload_that_is_not_valid_is_recorded_as_bytes(tmp_path: Path) -> None:
    async def body(virtual: VirtualFleet, recorded: RecordedFleet, tutti: Tutti) -> None:
        bus = virtual.net.join_process("other")
        header = FrameHeader(
            host="local", instance="i", number=0, utc=virtual.clock.utc(), lines=["gantry/state"] * 2, states={}
        )
        payload = encode_frame(header, [b"\xff\x00 no JSON", b'{"schema": "tutti.state/1"}'])
        bus.put(virtual.keys.host_events("local"), payload)
        bus.put(virtual.keys.prefix + "/user/key", b'{"a": 1}')
        await asyncio.sleep(1)

    recorded = record_run(tmp_path, body)
    assert recorded.writer.invalid == 2
    found = read_messages(recorded.files("fleet")[0])
    assert [each.payload for each in found if not each.valid] == [b"\xff\x00 no JSON", b'{"schema": "tutti.state/1"}']
    assert any(each.key == "user/key" and each.valid for each in found)


def test_a_recorder_only_listens(tmp_path: Path) -> None:
    async def body(virtual: VirtualFleet, recorded: RecordedFleet, tutti: Tutti) -> None:
        calls: list[str] = []
        for name in ("put", "serve", "request", "request_all", "find_servers"):
            setattr(recorded.bus, name, lambda *_, name=name, **__: calls.append(name))
        await run_jobs(tutti, PREPARE)
        assert calls == []

    record_run(tmp_path, body)


@pytest.mark.parametrize("begun", ["before", "within"])
def test_a_recorder_that_starts_within_a_job_records_the_rest_of_it(tmp_path: Path, begun: str) -> None:
    async def main(virtual: VirtualFleet) -> RecordedFleet:
        tutti = virtual.make_client("anna")
        await run_jobs(tutti, PREPARE)
        recorded = RecordedFleet(virtual, tmp_path)
        handle = None
        if begun == "within":
            handle = await tutti.submit(MOVE)
            await asyncio.sleep(3)
        await recorded.recorder.start()
        running = asyncio.ensure_future(recorded.recorder.run())
        handle = handle or await tutti.submit(MOVE)
        await handle.result()
        await asyncio.sleep(4)
        running.cancel()
        await recorded.recorder.close()
        return recorded

    recorded = run_fleet(main)
    (path,) = recorded.files("job")
    states = read_messages(path, lambda key: key.startswith("ctl/") and key.endswith("/state"))
    assert {each.key.split("/")[1] for each in states} == {"gantry", "stage"}


def test_the_recording_of_a_job_whose_end_was_not_seen_is_completed(tmp_path: Path) -> None:
    """Its coordinator was killed, and the next one has published the end before the recorder was there."""

    async def main(virtual: VirtualFleet) -> RecordedFleet:
        tutti = virtual.make_client("anna")
        await run_jobs(tutti, PREPARE)
        recorded = RecordedFleet(virtual, tmp_path)
        await recorded.recorder.start()
        running = asyncio.ensure_future(recorded.recorder.run())
        lost = await tutti.submit(MOVE)
        await asyncio.sleep(3)
        original = recorded.writer.write_messages
        # From here on nothing of this job arrives.
        recorded.writer.write_messages = lambda messages: original([m for m in messages if lost not in m.key])
        await tutti.wait_for_job(lost)
        await tutti.wait_for_job(await tutti.submit(job("[{do: dwell, duration: 1 s}]")))
        await asyncio.sleep(5)
        assert lost not in recorded.folder.open
        running.cancel()
        await recorded.recorder.close()
        return recorded

    recorded = run_fleet(main)
    assert all(summarize_recording(each).is_complete for each in recorded.files("job"))
