"""Reading of recordings: messages in order, attachments, and what a file is about. Files without an index as well."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.records import Attachment, Channel, Message, Metadata

from orchestrator.model.errors import TuttiError
from orchestrator.monitor.recording.channels import INVALID
from orchestrator.monitor.recording.file import METADATA, SUFFIX
from orchestrator.monitor.recording.frames import Damage, read_frames, read_index


class RecordingUnreadable(TuttiError):
    """A file is no recording. The text names it, the reason, and the remedy."""


class RecordedMessage(NamedTuple):
    """One message of a recording. key: without the fleet's prefix. Times in ns since 1970, UTC."""

    key: str
    payload: bytes
    received_ns: int
    published_ns: int
    valid: bool


@dataclass(slots=True)
class RecordingSummary:
    """What a recording is about. job_id, job_name: empty for a recording of the fleet. messages, begins_ns, ends_ns:
    None for a file without an index. is_complete: it has an index."""

    path: Path
    size: int
    is_complete: bool
    description: dict[str, str] = field(default_factory=dict[str, str])
    messages: int | None = None
    begins_ns: int | None = None
    ends_ns: int | None = None

    @property
    def fleet(self) -> str:
        return self.description.get("fleet", "")

    @property
    def job_id(self) -> str:
        return self.description.get("job_id", "")

    @property
    def job_name(self) -> str:
        return self.description.get("job_name", "")


class Recording:
    """A recording that is being read. It stays readable when the file is deleted meanwhile. Use it as a context."""

    def __init__(self, path: Path) -> None:
        """Raises `RecordingUnreadable`, `OSError`."""
        self._path = path
        self._file: BinaryIO = path.open("rb")
        self._size = path.stat().st_size
        self.damage: Damage | None = None
        """Where the file could not be read any further, once it was read."""

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read_messages(self) -> Iterator[RecordedMessage]:
        """The messages, in the order in which they were received. Raises `RecordingUnreadable`."""
        channels: dict[int, Channel] = {}
        for record in self._read_records():
            if isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                topic = channels[record.channel_id].topic
                key = topic.removesuffix(INVALID).split("/", 3)[3]
                valid = not topic.endswith(INVALID)
                yield RecordedMessage(key, record.data, record.log_time, record.publish_time, valid)

    def read_attachments(self) -> dict[str, bytes]:
        """The attachments by name; of several with one name, the last. Raises `RecordingUnreadable`."""
        return {record.name: record.data for record in self._read_records() if isinstance(record, Attachment)}

    def _read_records(self) -> Iterator[object]:
        for group in read_frames(self._file, self._size):
            if isinstance(group, Damage):
                if group.at == 0:
                    raise RecordingUnreadable(f"{self._path}: {group.text}; it is no recording")
                self.damage = group
            else:
                yield from group.records


def summarize_recording(path: Path) -> RecordingSummary:
    """What a file is about; quick, also for a large one. Raises `RecordingUnreadable`, `OSError`."""
    size = path.stat().st_size
    with path.open("rb") as file:
        index = read_index(file, size)
        summary = RecordingSummary(path, size, index is not None)
        for group in read_frames(file, size):
            if isinstance(group, Damage):
                if group.at == 0:
                    raise RecordingUnreadable(f"{path}: {group.text}; it is no recording")
                break
            records = [record for record in group.records if isinstance(record, Metadata) and record.name == METADATA]
            if records:
                summary.description = records[0].metadata
                break
    if index is not None and index.statistics is not None:
        figures = index.statistics
        summary.messages = figures.message_count
        summary.begins_ns, summary.ends_ns = figures.message_start_time, figures.message_end_time
    return summary


def list_recordings(folder: Path) -> list[RecordingSummary]:
    """The recordings of a folder, oldest first; what is none is left out. Raises `OSError`."""
    recordings: list[RecordingSummary] = []
    for path in sorted(folder.glob(f"*{SUFFIX}"), key=lambda file: file.name.partition("-")[2]):
        try:
            recordings.append(summarize_recording(path))
        except (RecordingUnreadable, FileNotFoundError):
            continue
    return recordings
