"""Repair of recordings that were not closed: what is whole is kept, and gets an index."""

from dataclasses import dataclass
from pathlib import Path

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from orchestrator.model.errors import TuttiError
from orchestrator.monitor.recording.file import CHUNK_BYTES, create_file
from orchestrator.monitor.recording.frames import Damage, FrameGroup, read_frames, read_index

DAMAGED = ".damaged"  # added to the name of the original, if the damage is not at its end
REPAIRED = ".repaired"  # of a copy that is being written


class RepairFailed(TuttiError):
    """A file is no recording, or cannot be repaired. The text names it, the reason, and the remedy."""


@dataclass(frozen=True, slots=True)
class RepairResult:
    """What a repair has kept. at: the byte from which on the file could not be read; None: nothing was wrong.

    original: where the file is kept as it was, because whole parts may follow the damage.
    """

    path: Path
    messages: int
    at: int | None = None
    reason: str = ""
    lost_bytes: int = 0
    original: Path | None = None


def repair_recording(path: Path) -> RepairResult:
    """Write the recording anew up to the first damaged chunk, with an index, and put it in the place of the old one.

    A complete file stays as it is. Raises `RepairFailed`, `OSError`; then the file is as it was.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        damage, messages = None, 0
        for frame in read_frames(file, size):
            if isinstance(frame, Damage):
                damage = frame
            else:
                messages += frame.message_count
        if damage is None and read_index(file, size) is not None:
            return RepairResult(path, messages)
        if damage is not None and damage.at == 0:
            raise RepairFailed(f"{path}: {damage.text}; it is no recording")
        copy = path.with_name(f"{path.name}{REPAIRED}")
        copy.unlink(missing_ok=True)
        try:
            messages, whole_until = _copy_whole_part(path, copy)
        except BaseException:
            copy.unlink(missing_ok=True)
            raise
    original = None
    if damage is not None and not damage.is_cut:  # whole chunks may follow it
        original = path.with_name(f"{path.name}{DAMAGED}")
        path.replace(original)
    copy.replace(path)
    at, reason = (size, "its index is damaged") if damage is None else (damage.at, damage.text)
    return RepairResult(
        path=path, messages=messages, at=at, reason=reason, lost_bytes=size - whole_until, original=original
    )


def _copy_whole_part(path: Path, copy: Path) -> tuple[int, int]:
    """Write the whole part of a recording to `copy`; return the number of messages, and where it ends."""
    whole_until, size = 0, path.stat().st_size
    with path.open("rb") as source, create_file(copy) as target:
        writer = Writer(target, chunk_size=2 * CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="tutti", library="tutti")
        recording = _RecordCopier(writer)
        for group in read_frames(source, size):
            if isinstance(group, FrameGroup):
                for record in group.records:
                    recording.copy_record(record)
                writer.flush()  # the chunks stay as they were
                whole_until = group.ends_at
        writer.finish()
    return recording.messages, whole_until


class _RecordCopier:
    """Adds records to a writer, under the numbers that it gives. messages: how many."""

    def __init__(self, writer: Writer) -> None:
        self.messages = 0
        self._writer = writer
        self._schemas = {0: 0}
        self._channels: dict[int, int] = {}

    def copy_record(self, record: McapRecord) -> None:
        writer = self._writer
        if isinstance(record, Schema) and record.id not in self._schemas:
            self._schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in self._channels:
            schema = self._schemas[record.schema_id]
            self._channels[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schema, record.metadata
            )
        elif isinstance(record, Message):
            self.messages += 1
            number = self._channels[record.channel_id]
            writer.add_message(number, record.log_time, record.data, record.publish_time, record.sequence)
        elif isinstance(record, Attachment):
            writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
