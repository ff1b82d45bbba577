"""The log file: rotation by several processes, a full disk, and a deleted folder."""

import errno
import json
import os
import shutil
from pathlib import Path

import pytest

from orchestrator.bus import logfile
from orchestrator.bus.logfile import KEPT_LOGS, LogFile, rotate_open_file
from orchestrator.model.files.private_files import open_for_append


def lines_of(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines()


def test_two_processes_rotate_one_file_and_lose_no_line(tmp_path: Path) -> None:
    path = tmp_path / "log" / "host.jsonl"
    logs = [LogFile(path, max_bytes=100), LogFile(path, max_bytes=100)]
    for number in range(24):
        logs[number % 2].append_line(f"line {number:04}")
    files = [path, *(path.with_name(f"{path.name}.{number}") for number in range(1, KEPT_LOGS + 1))]
    assert sorted(each.name for each in path.parent.iterdir()) == sorted(each.name for each in files if each.exists())
    assert [line for each in reversed(files) if each.exists() for line in lines_of(each)] == [
        f"line {number:04}" for number in range(24)
    ]
    assert {each.stat().st_mode & 0o777 for each in files if each.exists()} == {0o600}
    for number in range(100):
        logs[number % 2].append_line(f"line {number:04}")
    assert sum(each.stat().st_size for each in path.parent.iterdir()) <= (KEPT_LOGS + 1) * 120
    for log in logs:
        log.close()


def test_a_full_disk_loses_lines_and_counts_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = LogFile(tmp_path / "log.jsonl")
    log.append_line("first")

    def refuse_write(_: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(logfile.os, "write", refuse_write)
        log.append_line("second")
        log.append_line("third")
    log.append_line("fourth")
    first, count, last = lines_of(tmp_path / "log.jsonl")
    assert (first, last) == ("first", "fourth")
    assert json.loads(count)["text"] == "2 lines could not be written: No space left on device"
    log.close()


def test_a_deleted_folder_is_created_again(tmp_path: Path) -> None:
    log = LogFile(tmp_path / "log" / "a.jsonl")
    log.append_line("first")
    shutil.rmtree(tmp_path / "log")
    log.append_line("second")
    assert lines_of(tmp_path / "log" / "a.jsonl") == ["second"]
    (tmp_path / "log" / "a.jsonl").unlink()
    (tmp_path / "log" / "a.jsonl").symlink_to(tmp_path / "other")
    log.append_line("third")
    assert not (tmp_path / "other").exists()
    log.close()


def test_a_file_that_another_process_keeps_open_is_copied_and_emptied(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "host.err"
    rotate_open_file(path, max_bytes=100)  # there is none
    with os.fdopen(open_for_append(path), "ab", buffering=0) as child:
        for number in range(34):
            child.write(f"line {number:04}\n".encode())
            rotate_open_file(path, max_bytes=100)
        kept = [path, *(path.with_name(f"{path.name}.{number}") for number in range(1, KEPT_LOGS + 1))]
        assert sorted(tmp_path.iterdir()) == kept
        assert [line for each in reversed(kept) for line in lines_of(each)] == [f"line {n:04}" for n in range(34)]
        assert {each.stat().st_mode & 0o777 for each in kept} == {0o600}
        # A full disk: there is no copy, and the file is emptied all the same.
        child.write(b"x" * 200)

        def refuse_copy(_: Path, contents: bytes) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr(logfile, "replace_private_file", refuse_copy)
        rotate_open_file(path, max_bytes=100)
        assert path.stat().st_size == 0
        child.write(b"next\n")
        assert path.read_bytes() == b"next\n"
