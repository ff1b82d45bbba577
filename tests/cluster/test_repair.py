"""Repair of recordings that were cut or damaged: every chunk that was closed is kept; and the commands for recordings."""

import asyncio
import json
from pathlib import Path
from random import Random

import pytest
from click.testing import CliRunner
from cluster.recordings import RecordedFleet, read_messages
from cluster.worlds import PREPARE, run_fleet
from mcap.reader import make_reader

from orchestrator.cli.main import main as command
from orchestrator.monitor.recording.frames import FrameGroup, read_frames
from orchestrator.monitor.recording.lock import FolderInUse, FolderLock
from orchestrator.monitor.recording.reader import RecordingUnreadable, list_recordings, summarize_recording
from orchestrator.monitor.recording.repair import RepairFailed, repair_recording
from orchestrator.monitor.recording.unfinished import list_unfinished
from orchestrator.runtime.virtual.fleet import VirtualFleet

CUTS = 60  # in every run; the benchmark makes 500 more


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of five seconds of the demo fleet, complete."""
    folder = tmp_path_factory.mktemp("whole")

    async def main(virtual: VirtualFleet) -> None:
        recorded = RecordedFleet(virtual, folder)
        await recorded.recorder.start()
        running = asyncio.ensure_future(recorded.recorder.run())
        tutti = virtual.make_client("anna")
        await tutti.wait_for_job(await tutti.submit(PREPARE))
        await asyncio.sleep(3.5)
        running.cancel()
        await recorded.recorder.close()

    run_fleet(main)
    (path,) = folder.glob("job-*.mcap")
    return path


def list_chunks(path: Path) -> list[tuple[int, int]]:
    """Of each chunk, where it ends and how many messages it has."""
    with path.open("rb") as file:
        groups = [each for each in read_frames(file, path.stat().st_size) if isinstance(each, FrameGroup)]
    counted = [(each.ends_at, each.message_count) for each in groups]
    return [each for each in counted if each[1]]


def test_a_file_cut_at_any_byte_keeps_every_closed_chunk_and_gets_an_index(whole: Path, tmp_path: Path) -> None:
    data, chunks, draw = whole.read_bytes(), list_chunks(whole), Random(3)
    assert len(chunks) >= 4
    copy = tmp_path / "cut.mcap"
    edges = [end + shift for end, _ in chunks for shift in (-1, 0, 1)]
    for cut in sorted({*edges, *(draw.randrange(100, len(data)) for _ in range(CUTS))}):
        copy.write_bytes(data[:cut])
        result = repair_recording(copy)
        assert result.messages == sum(count for end, count in chunks if end <= cut)
        with copy.open("rb") as file:
            summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count == result.messages
        assert read_messages(copy) == read_messages(whole)[: result.messages]
        assert repair_recording(copy).reason == ""


def test_a_flipped_bit_of_the_summary_is_found_and_mended(whole: Path, tmp_path: Path) -> None:
    data, draw = whole.read_bytes(), Random(4)
    summary_at = int.from_bytes(data[-8 - 20 : -8 - 12], "little")
    copy = tmp_path / "flipped.mcap"
    places = [len(data) - 8 - back for back in (1, 4, 5, 12, 20, 28, 29)]
    for at in [*places, *(draw.randrange(summary_at, len(data) - 8) for _ in range(40))]:
        flipped = bytearray(data)
        flipped[at] ^= 1 << draw.randrange(8)
        copy.write_bytes(flipped)
        assert repair_recording(copy).reason != "", at
        with copy.open("rb") as file:
            assert make_reader(file, validate_crcs=True).get_summary() is not None
        assert read_messages(copy) == read_messages(whole)


def test_a_damaged_chunk_ends_the_repaired_file_and_the_original_is_kept(whole: Path, tmp_path: Path) -> None:
    data, chunks = bytearray(whole.read_bytes()), list_chunks(whole)
    place = (chunks[1][0] + chunks[2][0]) // 2
    data[place : place + 40] = bytes(40)
    copy = tmp_path / "damaged.mcap"
    copy.write_bytes(data)
    result = repair_recording(copy)
    assert result.messages == chunks[0][1] + chunks[1][1] and result.original is not None
    assert result.original.read_bytes() == bytes(data)
    assert summarize_recording(copy).messages == result.messages


@pytest.mark.parametrize("seed", range(3))
def test_random_damage_ends_in_a_readable_file_or_a_message(whole: Path, tmp_path: Path, seed: int) -> None:
    draw, data = Random(seed), whole.read_bytes()
    copy = tmp_path / "random.mcap"
    for _ in range(15):
        bad = bytearray(data)
        for _ in range(draw.randrange(1, 6)):
            bad[draw.randrange(len(bad))] ^= 1 << draw.randrange(8)
        copy.write_bytes(bad)
        try:
            repair_recording(copy)
        except RepairFailed as error:
            assert "it is no recording" in str(error)
            continue
        assert summarize_recording(copy).is_complete
        read_messages(copy)


def test_an_interrupted_repair_leaves_the_file_as_it_was(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "cut.mcap"
    copy.write_bytes(whole.read_bytes()[:-300])
    before = copy.read_bytes()

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mcap.writer.Writer.finish", fail)
    with pytest.raises(OSError, match="No space left"):
        repair_recording(copy)
    assert copy.read_bytes() == before and list(tmp_path.iterdir()) == [copy]


def test_what_a_recorder_has_left_is_found_and_one_recorder_uses_a_folder(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "fleet-1.mcap").write_bytes(whole.read_bytes()[:-20])
    (tmp_path / "fleet-2.mcap").write_bytes(whole.read_bytes())
    assert list_unfinished(tmp_path) == [tmp_path / "fleet-1.mcap"]
    lock = FolderLock(tmp_path)
    with pytest.raises(FolderInUse, match="another recorder uses this folder; end that one, or choose another"):
        FolderLock(tmp_path)
    lock.release()
    FolderLock(tmp_path).release()


# Commands


def run(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(command, list(words))
    assert "Traceback" not in result.output
    return result.exit_code, " ".join(result.output.split())


def test_record_ls_lists_what_there_is_and_in_which_state(whole: Path, tmp_path: Path) -> None:
    (tmp_path / whole.name).write_bytes(whole.read_bytes())
    (tmp_path / "fleet-20260101T000000Z.mcap").write_bytes(whole.read_bytes()[:-20])
    (tmp_path / "other.mcap").write_bytes(b"no recording")
    code, shown = run("record", "ls", "--folder", str(tmp_path), "--json")
    found = {each["file"].rpartition("/")[2]: each for each in json.loads(shown)}
    assert code == 0 and set(found) == {whole.name, "fleet-20260101T000000Z.mcap"}
    assert found[whole.name]["state"] == "complete" and found[whole.name]["messages"] == len(read_messages(whole))
    assert found["fleet-20260101T000000Z.mcap"]["state"] == "needs repair"
    lock = FolderLock(tmp_path)
    assert "being written" in run("record", "ls", "--folder", str(tmp_path))[1]
    lock.release()
    assert run("record", "ls", "--folder", str(tmp_path / "none"))[0] == 2
    assert len(list_recordings(tmp_path)) == 2


def test_record_repair_says_what_it_has_kept(whole: Path, tmp_path: Path) -> None:
    cut, other = tmp_path / "cut.mcap", tmp_path / "other.mcap"
    cut.write_bytes(whole.read_bytes()[:-20])
    other.write_bytes(b"no recording")
    code, shown = run("record", "repair", str(cut), str(whole))
    assert code == 0 and f"{len(read_messages(whole))} messages" in shown and "it is whole" in shown
    code, shown = run("record", "repair", str(other), str(tmp_path / "missing.mcap"))
    assert code == 1 and "it does not begin as an MCAP file does; it is no recording" in shown
    assert "missing.mcap: No such file or directory" in shown
    with pytest.raises(RecordingUnreadable):
        summarize_recording(other)


@pytest.mark.parametrize(
    ("words", "text"), [("2", "is no size; write a number and one of"), ("0 GB", "more than nothing")]
)
def test_a_quota_that_is_no_size_is_refused(tmp_path: Path, words: str, text: str) -> None:
    code, shown = run("record", "start", "--fleet", "lab", "--folder", str(tmp_path), "--quota", words)
    assert code == 2 and text in shown


def test_a_folder_that_cannot_be_used_is_named_with_the_reason(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("not a folder")
    code, shown = run("record", "start", "--fleet", "lab", "--folder", str(file), "--connect", "tcp/127.0.0.1:1")
    assert code == 2 and str(file) in shown and "Not a directory" in shown
    link = tmp_path / "link"
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / ".lock").symlink_to(file)
    code, shown = run("record", "start", "--fleet", "lab", "--folder", str(link.parent / "folder"))
    assert code == 2 and "is a symbolic link" in shown
