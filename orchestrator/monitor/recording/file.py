"""One MCAP file that is being written: messages in chunks, attachments, and its end."""

import os
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap import writer as mcap_writer
from mcap.writer import CompressionType, Writer

from orchestrator.model.files.private_files import make_private_folder, open_private_file
from orchestrator.monitor.recording.channels import BYTES, INVALID, JSON, Channel, make_schema

SUFFIX = ".mcap"
METADATA = "tutti"  # the name of the record that describes the file
CHUNK_BYTES = 4_000_000  # before compression; a chunk is also closed once a second, and each one has an index

ZSTD_LEVEL = 9  # 15 % smaller than the usual level 3, for 0.5 % of a processor at 1,600 messages a second


class _DenseCompressor:
    """Stands for the module `zstandard` in the library, which has no option for the level."""

    @staticmethod
    def compress(data: bytes) -> bytes:
        return zstandard.compress(data, ZSTD_LEVEL)


mcap_writer.zstandard = _DenseCompressor  # pyright: ignore[reportPrivateImportUsage]

OpenFile = Callable[[Path], BinaryIO]


def create_file(path: Path) -> BinaryIO:
    """Create a file for this user alone. Raises `OSError`, also if it exists."""
    make_private_folder(path.parent)
    return os.fdopen(open_private_file(path, os.O_RDWR | os.O_CREAT | os.O_EXCL), "wb")


class RecordingFile:
    """A recording that is being written. All times in ns since 1970.

    written: number of messages. unsafe: those that are not on the disk yet, by key. All methods raise `OSError` if the
    disk takes no data; then the file ends with the last chunk that was closed, and only `abandon` may follow.
    """

    def __init__(self, path: Path, description: dict[str, str], open_file: OpenFile = create_file) -> None:
        self.path = path
        self.written = 0
        self.unsafe: Counter[str] = Counter()
        self._stream = open_file(path)
        self._channels: dict[tuple[str, str], int] = {}
        self._schemas: dict[str, int] = {}
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="tutti", library="tutti")
        self._writer.add_metadata(METADATA, description)

    @property
    def size(self) -> int:
        """Bytes written so far, without the chunk that is open."""
        return self._stream.tell()

    def write_message(self, channel: Channel, payload: bytes, times_ns: tuple[int, int], *, valid: bool = True) -> None:
        """Add a message. times_ns: when it was received, and its publisher's own instant."""
        received_ns, published_ns = times_ns
        number = self._find_channel(channel, JSON if valid else BYTES)
        self.written += 1
        self.unsafe[channel.key] += 1
        # Without a number of its own: it would cost a tenth of the compressed size.
        self._writer.add_message(number, received_ns, payload, published_ns)

    def attach(self, name: str, contents: bytes, at_ns: int, media_type: str = "application/json") -> None:
        """Add an attachment."""
        self._writer.add_attachment(at_ns, at_ns, name, media_type, contents)

    def close_chunk(self) -> None:
        """Close the open chunk, and bring it to the disk."""
        self._writer.flush()
        os.fsync(self._stream.fileno())
        self.unsafe.clear()

    def finish(self) -> None:
        """Write the index, and close the file."""
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()

    def abandon(self) -> None:
        """Close the file after an error, without an index. Raises nothing."""
        # What is buffered cannot be written; closing would try again.
        with suppress(OSError):
            self._stream.close()

    def _find_channel(self, channel: Channel, encoding: str) -> int:
        key = (channel.key, encoding)
        number = self._channels.get(key)
        if number is None:
            schema = self._find_schema(channel) if encoding == JSON else 0
            topic = channel.key if encoding == JSON else f"{channel.key}{INVALID}"
            number = self._channels[key] = self._writer.register_channel(topic, encoding, schema)
        return number

    def _find_schema(self, channel: Channel) -> int:
        if channel.model is None:
            return 0
        name, text = make_schema(channel.model)
        if name not in self._schemas:
            self._schemas[name] = self._writer.register_schema(name, "jsonschema", text)
        return self._schemas[name]
