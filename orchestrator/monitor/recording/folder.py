"""The recordings of a folder that are being written: begun, ended, and given up when the disk refuses."""

import errno
import platform
import re
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.model.files.private_files import UnsafePath
from orchestrator.monitor.recording.channels import Channel
from orchestrator.monitor.recording.file import SUFFIX, OpenFile, RecordingFile, create_file
from orchestrator.monitor.recording.instants import UtcScale
from orchestrator.monitor.recording.jobs import TrackedJob

RETRY_NS = 5 * NS_PER_S  # after the disk has refused data
FLEET = ""  # names the recording of everything that belongs to no job

Alarm = Callable[[str, str, bool], None]
"""Raises an alarm, or ends it: its kind, a text, and whether it holds."""


@dataclass(frozen=True, slots=True)
class RecorderLimits:
    """quota: bytes of all recordings. rotate_bytes, rotate_ns: size and time after which the recording of the fleet
    goes on in another file."""

    quota: int = 2_000_000_000
    rotate_bytes: int = 256_000_000
    rotate_ns: int = 3600 * NS_PER_S


@dataclass(slots=True)
class OpenRecording:
    """A recording that is being written. scale: its times. Instants of this host; ended_ns: its job had ended then."""

    file: RecordingFile
    scale: UtcScale
    begun_ns: int
    ended_ns: int | None = None


class RecordingFolder:
    """The open recordings of one fleet in a folder, by job id, or `FLEET`.

    A recording that the disk does not take any more is given up as it is, and begun anew some seconds later.
    """

    def __init__(
        self, path: Path, fleet: str, clock: Clock, limits: RecorderLimits, open_file: OpenFile = create_file
    ) -> None:
        self.open: dict[str, OpenRecording] = {}
        self.is_full = False
        """The recordings of running jobs alone use up the quota."""
        self.on_alarm: Alarm = lambda kind, text, active: None
        self.on_lost: Callable[[Counter[str]], None] = lambda counts: None
        """Receives the number of messages by key that a recording which is given up has taken with it, at most."""
        self._path, self._fleet, self._clock, self._limits = path, fleet, clock, limits
        self._open_file = open_file
        self._retry_ns: int | None = None

    def refuses_now(self) -> bool:
        """Whether the disk has refused data, and is not to be tried again yet."""
        return self._retry_ns is not None and self._clock.now_ns() < self._retry_ns

    def begin_recording(self, name: str, job: TrackedJob | None) -> OpenRecording | None:
        """Begin a recording. None: the disk refuses."""
        if self.refuses_now():
            return None
        scale, now_ns = UtcScale(self._clock), self._clock.now_ns()
        kind = {"kind": "fleet"} if job is None else {"kind": "job", "job_id": job.job_id, "job_name": job.name}
        description = {"schema": "tutti.recording-file/1", "fleet": self._fleet, **kind, **_list_versions()}
        try:
            path = self._find_free_path(job, scale.utc_ns(now_ns))
            recording = OpenRecording(RecordingFile(path, description, self._open_file), scale, now_ns)
        except OSError as error:
            self._report_trouble(error)
            return None
        self.open[name] = recording
        if self._retry_ns is not None:
            self._retry_ns = None
            self.on_alarm("recording", f"{self._path}: recordings are written again", False)  # noqa: FBT003
        return recording

    def write_message(
        self, name: str, channel: Channel, payload: bytes, times_ns: tuple[int, int], *, valid: bool
    ) -> None:
        """Write a message to an open recording; if the disk refuses, the recording is given up."""
        try:
            self.open[name].file.write_message(channel, payload, times_ns, valid=valid)
        except OSError as error:
            self._give_up(name, error)

    def write_safely(self, name: str, write: Callable[[RecordingFile], None]) -> bool:
        """Do something else with an open recording; if the disk refuses, it is given up. Return whether it was done."""
        try:
            write(self.open[name].file)
        except OSError as error:
            self._give_up(name, error)
            return False
        return True

    def _give_up(self, name: str, error: OSError) -> None:
        file = self.open.pop(name).file
        file.abandon()
        self.on_lost(file.unsafe)
        self._report_trouble(error)

    def end_recording(self, name: str) -> None:
        """Write its index, and close it."""
        if self.write_safely(name, RecordingFile.finish):
            del self.open[name]

    def close_chunks(self) -> None:
        """Bring to the disk what was written so far."""
        for name in list(self.open):
            self.write_safely(name, RecordingFile.close_chunk)

    def must_rotate(self) -> bool:
        """Whether the recording of the fleet is to go on in another file."""
        fleet_recording = self.open.get(FLEET)
        if fleet_recording is None:
            return False
        limits, age_ns = self._limits, self._clock.now_ns() - fleet_recording.begun_ns
        return fleet_recording.file.size >= limits.rotate_bytes or age_ns >= limits.rotate_ns

    def keep_quota(self) -> None:
        """Delete the oldest recordings beyond the quota."""
        open_files = {recording.file.path for recording in self.open.values()}
        try:
            used = delete_oldest(self._path, self._limits.quota, open_files)
        except OSError as error:
            self._report_trouble(error)
            return
        full = used > self._limits.quota
        if full != self.is_full:
            self.is_full = full
            quota = f"{self._limits.quota / 1e6:g} MB"
            self.on_alarm("recording-quota", f"{self._path}: running jobs use up {quota}; states are left out", full)

    def _find_free_path(self, job: TrackedJob | None, utc_ns: int) -> Path:
        stamp = datetime.fromtimestamp(utc_ns // NS_PER_S, UTC).strftime("%Y%m%dT%H%M%SZ")
        stem = f"fleet-{stamp}" if job is None else f"job-{stamp}-{_shorten_name(job.name)}-{job.job_id[:8]}"
        path, count = self._path / f"{stem}{SUFFIX}", 1
        while path.exists():
            count += 1
            path = self._path / f"{stem}-{count}{SUFFIX}"
        return path

    def _report_trouble(self, error: OSError) -> None:
        self._retry_ns = self._clock.now_ns() + RETRY_NS
        text = f"{self._path}: {error.strerror or error}; {_explain_remedy(error)}"
        self.on_alarm("recording", text, True)  # noqa: FBT003 - the state of the alarm


def delete_oldest(folder: Path, quota: int, open_files: Collection[Path]) -> int:
    """Delete the oldest recordings until all together take at most `quota` bytes; return what they take then.

    `open_files` stay, and so does the newest of the others: a run that alone is larger than the quota can still be
    looked at. A file that is being read stays readable for its reader. Raises `OSError`.
    """
    files: list[tuple[float, str, int, Path]] = []
    for path in folder.glob(f"*{SUFFIX}*"):
        try:
            status = path.stat()
        except FileNotFoundError:
            continue
        files.append((status.st_mtime, path.name, status.st_size, path))
    used = sum(size for _, _, size, _ in files)
    ended_files = sorted(file for file in files if file[3] not in open_files)
    for _, _, size, path in ended_files[:-1]:
        if used <= quota:
            break
        path.unlink(missing_ok=True)
        used -= size
    return used


def _explain_remedy(error: OSError) -> str:
    text = "the fleet runs on, and nothing is recorded meanwhile"
    if isinstance(error, UnsafePath):
        return "choose another folder"
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"free space there; {text}"
    return f"make it writable, or choose another folder; {text}"


def _shorten_name(text: str) -> str:
    """A job's name as part of a file's name."""
    return re.sub(r"[^A-Za-z0-9]+", "-", text).strip("-").lower()[:40] or "job"


def _list_versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for name in ("tutti", "eclipse-zenoh", "mcap", "ruckig"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return versions
