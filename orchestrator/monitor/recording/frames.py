"""The records of an MCAP file as they lie in it, up to the first that is incomplete or damaged.

The library's reader relies on the length of a record; in a damaged file it can be anything.
"""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

_HEAD = struct.Struct("<BQ")
_PARSERS = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.CHUNK: Chunk,
}
# What the library raises for bytes that are none of its records.
_DAMAGE = (McapError, ZstdError, struct.error, ValueError, EOFError, KeyError, IndexError, MemoryError, OverflowError)


class FrameGroup(NamedTuple):
    """What a chunk has, or a record outside of chunks. ends_at: the byte after it."""

    records: list[McapRecord]
    ends_at: int

    @property
    def message_count(self) -> int:
        """How many of the records are messages."""
        return sum(isinstance(record, Message) for record in self.records)


class Damage(NamedTuple):
    """Where a file cannot be read any further, and why. at: byte. is_cut: the file ends there, nothing can follow."""

    at: int
    text: str
    is_cut: bool = False


def read_frames(file: BinaryIO, size: int) -> Iterator[FrameGroup | Damage]:
    """Read a file from its beginning: groups of records, and at the end `Damage` unless the file is complete."""
    file.seek(0)
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        yield Damage(0, "it does not begin as an MCAP file does")
        return
    at = len(MCAP0_MAGIC)
    while True:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            yield Damage(at, "it ends without an index", is_cut=True)
            return
        opcode, length = _HEAD.unpack(head)
        ends_at = at + _HEAD.size + length
        if ends_at > size:
            yield Damage(at, "its last record is cut off", is_cut=True)
            return
        if opcode == Opcode.DATA_END:
            return
        try:
            records = _parse_record(opcode, file.read(length))
        except _DAMAGE as error:
            yield Damage(at, f"a record is damaged: {error}")
            return
        if records:
            yield FrameGroup(records, ends_at)
        at = ends_at


_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, checksum


def read_index(file: BinaryIO, size: int) -> Summary | None:
    """The index at the end of a file; None if there is none, or it is damaged."""
    if not is_complete(file, size) or not _is_summary_whole(file, size):
        return None
    file.seek(0)
    try:
        return make_reader(file, validate_crcs=True).get_summary()
    except _DAMAGE:
        return None


def _is_summary_whole(file: BinaryIO, size: int) -> bool:
    """Whether the summary is as it was written, by its checksum in the footer (MCAP specification, Footer): over all
    bytes from the start of the summary to the checksum; 0: not computed."""
    footer_at = size - len(MCAP0_MAGIC) - _FOOTER.size
    if footer_at < len(MCAP0_MAGIC):
        return False
    file.seek(footer_at)
    opcode, length, summary_at, _, crc = _FOOTER.unpack(file.read(_FOOTER.size))
    if opcode != Opcode.FOOTER or length != _FOOTER.size - 9 or summary_at > footer_at:
        return False
    if not summary_at or not crc:
        return True
    file.seek(summary_at)
    return zlib.crc32(file.read(footer_at + _FOOTER.size - 4 - summary_at)) == crc


def is_complete(file: BinaryIO, size: int) -> bool:
    """Whether a file has its end: the writer has closed it."""
    if size < 2 * len(MCAP0_MAGIC):
        return False
    file.seek(size - len(MCAP0_MAGIC))
    return file.read() == MCAP0_MAGIC


def _parse_record(opcode: int, content: bytes) -> list[McapRecord]:
    """The records of a chunk, or one record; none of those that only repeat or index others."""
    if opcode == Opcode.ATTACHMENT:
        (crc,) = struct.unpack("<I", content[-4:])
        if crc and zlib.crc32(content[:-4]) != crc:
            raise ValueError("the checksum of an attachment differs")
        return [Attachment.read(ReadDataStream(BytesIO(content)))]
    parser = _PARSERS.get(Opcode(opcode)) if opcode in set(Opcode) else None
    if parser is None:
        return []
    record = parser.read(ReadDataStream(BytesIO(content)))
    return breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
