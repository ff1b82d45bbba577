"""Measures the recorder: nothing lost uncounted, processor time, size; and recordings that were cut, or killed."""

import asyncio
import json
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from orchestrator.bench.processes import read_cpu_s
from orchestrator.bench.truth import NothingHappened
from orchestrator.bus.base import BusError, BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.model.operation.recording import MessagesDropped
from orchestrator.monitor.recording.frames import FrameGroup, read_frames
from orchestrator.monitor.recording.reader import Recording, summarize_recording
from orchestrator.monitor.recording.repair import repair_recording
from orchestrator.runtime.live.fleet import find_free_port

FLEET = "bench"
CONTROLLERS, AXES, HZ = 16, 4, 100.0
CPU_TARGET, HOUR_TARGET_MB = 0.15, 250.0
CUT_S = 5.0  # of the recording that is cut
KILLS = 5


class RecordFigures(NamedTuple):
    """published = recorded + dropped. cpu_share: of one processor. others: keys that the recorder has put, and how
    often. answers: whether it answers queries. cuts: number of cut copies; lost_chunks: closed chunks missing after
    their repair; kills: of the recorder, each repaired."""

    axes: int
    hz: float
    seconds: float
    published: int
    recorded: int
    dropped: int
    cpu_share: float
    mb_per_hour: float
    others: dict[str, int]
    answers: bool
    cuts: int
    lost_chunks: int
    kills: int
    kill_losses: int
    counted: bool
    cpu_met: bool
    size_met: bool


async def bench_record(folder: Path, seconds: float, cuts: int, show_progress: Callable[[str], None]) -> RecordFigures:
    """Measure. Raises `NothingHappened`."""
    endpoint = f"tcp/127.0.0.1:{find_free_port()}"
    router = await start_part("orchestrator.bus.zenoh.router", endpoint, str(os.getpid()))
    try:
        show_progress(f"{CONTROLLERS * AXES} axes at {HZ:g} Hz for {seconds:g} s")
        run_folder = folder / "run"
        recorder = await _start_recorder(endpoint, run_folder)
        watcher = await _BusWatcher.start(endpoint)
        publications = await _publish(endpoint, seconds)
        answers = await watcher.find_answers()
        cpu_s = await _end_recorder(recorder)
        record_count, drop_count = _count_recorded(run_folder)
        size = sum(path.stat().st_size for path in run_folder.glob("*.mcap"))
        other_figures = await watcher.close()
        show_progress(f"{cuts} cut copies of a recording of {CUT_S:g} s")
        lost_chunks = await _cut_and_repair(endpoint, folder, cuts)
        show_progress(f"{KILLS} kills of the recorder")
        kill_losses = await _kill_and_repair(endpoint, folder)
    finally:
        router.terminate()
        await router.wait()
    mb = size / 1e6 / seconds * 3600
    return RecordFigures(
        axes=CONTROLLERS * AXES,
        hz=HZ,
        seconds=seconds,
        published=publications,
        recorded=record_count,
        dropped=drop_count,
        cpu_share=cpu_s / seconds,
        mb_per_hour=mb,
        others=other_figures,
        answers=answers,
        cuts=cuts,
        lost_chunks=lost_chunks,
        kills=KILLS,
        kill_losses=kill_losses,
        counted=record_count + drop_count == publications,
        cpu_met=cpu_s / seconds <= CPU_TARGET,
        size_met=mb <= HOUR_TARGET_MB,
    )


class _BusWatcher:
    """Counts what is put on the bus by others than the publisher."""

    def __init__(self, bus: Any) -> None:
        self._bus = bus
        self._keys = FleetKeys(FLEET)
        self._counted: Counter[str] = Counter()

    @classmethod
    async def start(cls, endpoint: str) -> "_BusWatcher":
        watcher = cls(await open_bus(endpoint))
        await watcher._bus.subscribe("**", watcher._count)
        return watcher

    def _count(self, sample: BusSample) -> None:
        if not sample.key.endswith("/state") and sample.key != self._keys.leader:
            self._counted[sample.key] += 1

    async def find_answers(self) -> bool:
        """Whether any process answers a query on any key of the fleet."""
        with suppress(BusError):
            return bool(await self._bus.find_servers(f"{self._keys.prefix}/**", 1.0))
        return False

    async def close(self) -> dict[str, int]:
        await self._bus.close()
        return dict(self._counted)


async def start_part(module: str, *arguments: str) -> asyncio.subprocess.Process:
    """Start a process, and wait until it is ready. Raises `NothingHappened`."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", module, *arguments, stdout=asyncio.subprocess.PIPE
    )
    assert process.stdout is not None
    if not await process.stdout.readline():
        raise NothingHappened(f"{module} has not started")
    return process


async def _start_recorder(endpoint: str, place: Path) -> asyncio.subprocess.Process:
    options = ["--fleet", FLEET, "--connect", endpoint, "--folder", str(place), "--quota", str(2 * 10**9)]
    return await start_part("orchestrator.monitor.recording.process", *options, "--log", str(place / "recorder.jsonl"))


async def _publish(endpoint: str, seconds: float) -> int:
    module, arguments = "orchestrator.bench.recording.publisher", [endpoint, FLEET, str(CONTROLLERS), f"{HZ}"]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", module, *arguments, f"{seconds}", "2", stdout=asyncio.subprocess.PIPE
    )
    output, _ = await process.communicate()
    return int(output)


async def _end_recorder(process: asyncio.subprocess.Process) -> float:
    """End it; return the processor time that it has used, with its start."""
    used_s = read_cpu_s(process.pid)
    process.terminate()
    await process.wait()
    return used_s


def _count_recorded(place: Path) -> tuple[int, int]:
    """How many states the recordings have, and how many they say were left out."""
    record_count = drop_count = 0
    for path in place.glob("*.mcap"):
        with Recording(path) as recording:
            for message in recording.read_messages():
                record_count += message.key.endswith("/state") and message.valid
                if message.key == "recorder/dropped":
                    drop_count += MessagesDropped.read_message(message.payload).total
    return record_count, drop_count


def _list_chunks(path: Path) -> list[tuple[int, int]]:
    """Of each closed chunk, where it ends and how many messages it has."""
    with path.open("rb") as file:
        groups = read_frames(file, path.stat().st_size)
        counted_ends = [(group.ends_at, group.message_count) for group in groups if isinstance(group, FrameGroup)]
    return [end for end in counted_ends if end[1]]


async def _cut_and_repair(endpoint: str, folder: Path, cuts: int) -> int:
    """Cut copies of a recording at random bytes, and repair them; return how many closed chunks were lost."""
    cut_folder = folder / "cut"
    recorder = await _start_recorder(endpoint, cut_folder)
    await _publish(endpoint, CUT_S)
    await _end_recorder(recorder)
    (path,) = cut_folder.glob("fleet-*.mcap")
    content, chunks, draw = path.read_bytes(), _list_chunks(path), Random(1)
    losses = 0
    copy = cut_folder / "copy.mcap"
    for _ in range(cuts):
        cut = draw.randrange(200, len(content))
        copy.write_bytes(content[:cut])
        result = repair_recording(copy)
        count = sum(messages for ends_at, messages in chunks if ends_at <= cut)
        recording_after = summarize_recording(copy)
        losses += (
            result.messages < count or not recording_after.is_complete or recording_after.messages != result.messages
        )
    return losses


async def _kill_and_repair(endpoint: str, folder: Path) -> int:
    """Kill the recorder at work; return in how many recordings a chunk that was closed before is missing."""
    losses, draw = 0, Random(2)
    for number in range(KILLS):
        kill_folder = folder / f"kill-{number}"
        recorder = await _start_recorder(endpoint, kill_folder)
        publishing = asyncio.ensure_future(_publish(endpoint, 4.0))
        await asyncio.sleep(2.0 + draw.random() * 2)
        (path,) = kill_folder.glob("fleet-*.mcap")
        message_count = sum(messages for _, messages in _list_chunks(path))
        recorder.send_signal(signal.SIGKILL)
        await recorder.wait()
        await publishing
        result = repair_recording(path)
        losses += result.messages < message_count or message_count == 0 or not summarize_recording(path).is_complete
    return losses


def describe_failures(figures: RecordFigures) -> list[str]:
    """What a measurement shows to be wrong, in words."""
    failures: list[str] = []
    if not figures.counted:
        failures.append(
            f"{figures.published - figures.recorded - figures.dropped} messages are neither recorded nor counted"
        )
    if figures.others:
        failures.append(f"put on the bus beside the publisher: {json.dumps(figures.others)}")
    if figures.answers:
        failures.append("a process answers queries")
    return failures
