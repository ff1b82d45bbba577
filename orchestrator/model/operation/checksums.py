"""Checksums of what is kept on a disk: a bit that has changed there is noticed when it is read.

A single changed digit would otherwise be another position, or another epoch.
"""

from zlib import crc32

from orchestrator.model.errors import TuttiError

_MARK = b"\ncrc32 "


class WrongChecksum(TuttiError, ValueError):
    """Contents are not what was written."""


def add_checksum(contents: bytes) -> bytes:
    """Return the contents of a file of one line with its checksum on a second one."""
    return contents + _MARK + b"%08x\n" % crc32(contents)


def take_checksum(data: bytes) -> bytes:
    """Return what `add_checksum` was given. Data without a checksum is from an older version, or written by a person,
    and is returned as it is. Raises `WrongChecksum`."""
    contents, mark, checksum = data.rpartition(_MARK)
    if not mark:
        return data
    if checksum != b"%08x\n" % crc32(contents):
        raise WrongChecksum("its checksum is wrong")
    return contents
