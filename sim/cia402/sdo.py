"""The SDO server: expedited, segmented and block transfers, in both directions (CiA 301, 7.2.4)."""

import binascii
from collections.abc import Callable
from dataclasses import dataclass, field

from sim.cia402 import aborts
from sim.cia402.aborts import SdoAbort
from sim.cia402.dictionary import DriveDictionary

SEGMENT_BYTES = 7
BLOCK_SEGMENTS = 127
LONGEST_BYTES = 1024
"""A client that announces more bytes is refused at once."""


@dataclass(slots=True)
class _SegmentedTransfer:
    """A transfer in segments, each of which is acknowledged."""

    index: int
    sub: int
    data: bytes = b""
    up: bool = field(kw_only=True)
    size: int | None = None
    toggle: int = 0


@dataclass(slots=True)
class _BlockTransfer:
    """A transfer in blocks of segments, each block of which is acknowledged.

    ending: the last segment has been transferred."""

    index: int
    sub: int
    data: bytes = b""
    up: bool = field(kw_only=True)
    size: int | None = None
    segments: int = BLOCK_SEGMENTS
    sequence: int = 0
    crc: bool = False
    at: int = 0
    ending: bool = False
    begun: bool = False


class SdoServer:
    """One server.

    reply: sends eight bytes to the client.
    watch: called with true while a transfer waits for its client, so that the caller can end it (`abort_timed_out`)
    when no frame arrives."""

    def __init__(
        self, dictionary: DriveDictionary, reply: Callable[[bytes], None], watch: Callable[[bool], None]
    ) -> None:
        self._dictionary = dictionary
        self._reply = reply
        self._watch = watch
        self._transfer: _SegmentedTransfer | _BlockTransfer | None = None

    def reset_transfer(self) -> None:
        self._transfer = None

    def abort_timed_out(self) -> None:
        """Abort the transfer: the client has been silent for too long."""
        if self._transfer is not None:
            self._send_abort(self._transfer.index, self._transfer.sub, aborts.TIMED_OUT)

    def handle_request(self, data: bytes) -> None:
        """Process eight bytes of a client."""
        if len(data) != 8:
            return
        transfer = self._transfer
        index, sub = int.from_bytes(data[1:3], "little"), data[3]
        if data[0] == 0x80:
            self._transfer = None
        else:
            try:
                if isinstance(transfer, _BlockTransfer) and not transfer.up and transfer.begun and not transfer.ending:
                    self._block_segment(transfer, data)
                else:
                    self._run_command(data, index, sub)
            except SdoAbort as error:
                present = self._transfer
                object_key = (present.index, present.sub) if present is not None else (index, sub)
                self._send_abort(*object_key, error.code)
        self._watch(self._transfer is not None)

    def _send_abort(self, index: int, sub: int, code: int) -> None:
        self._transfer = None
        self._reply(bytes([0x80, *index.to_bytes(2, "little"), sub, *code.to_bytes(4, "little")]))
        self._watch(self._transfer is not None)

    def _run_command(self, data: bytes, index: int, sub: int) -> None:
        command = data[0] >> 5
        if command == 1:
            self._start_download(data, index, sub)
        elif command == 2:
            self._start_upload(index, sub)
        elif command == 0:
            self._download_segment(data)
        elif command == 3:
            self._upload_segment(data)
        elif command == 5:
            self._block_upload(data, index, sub)
        elif command == 6:
            self._block_download(data, index, sub)
        else:
            raise SdoAbort(aborts.COMMAND)

    # Expedited and segmented

    def _start_download(self, data: bytes, index: int, sub: int) -> None:
        self._transfer = None
        is_expedited, has_size = data[0] & 2, data[0] & 1
        if is_expedited:
            # Without a size the object's own size applies.
            length = 4 - (data[0] >> 2 & 3) if has_size else min(4, self._dictionary.find_entry(index, sub).size)
            self._dictionary.download_value(index, sub, data[4 : 4 + length])
        else:
            entry = self._dictionary.find_entry(index, sub)
            if not entry.writable:
                raise SdoAbort(aborts.READ_ONLY)
            size = int.from_bytes(data[4:8], "little") if has_size else None
            if size is not None and size > LONGEST_BYTES:
                raise SdoAbort(aborts.TOO_LONG)
            self._transfer = _SegmentedTransfer(index, sub, up=False, size=size)
        self._reply(bytes([0x60, *data[1:4], 0, 0, 0, 0]))

    def _download_segment(self, data: bytes) -> None:
        transfer = self._require_segmented(up=False)
        if data[0] >> 4 & 1 != transfer.toggle:
            raise SdoAbort(aborts.TOGGLE)
        transfer.data += data[1 : 8 - (data[0] >> 1 & 7)]
        answer = bytes([0x20 | transfer.toggle << 4, 0, 0, 0, 0, 0, 0, 0])
        transfer.toggle ^= 1
        if len(transfer.data) > LONGEST_BYTES:
            raise SdoAbort(aborts.TOO_LONG)
        if data[0] & 1:
            if transfer.size is not None and len(transfer.data) != transfer.size:
                raise SdoAbort(aborts.LENGTH)
            self._dictionary.download_value(transfer.index, transfer.sub, transfer.data)
            self._transfer = None
        self._reply(answer)

    def _start_upload(self, index: int, sub: int) -> None:
        self._transfer = None
        value = self._dictionary.upload_value(index, sub)
        head = [*index.to_bytes(2, "little"), sub]
        if 0 < len(value) <= 4:
            self._reply(bytes([0x43 | (4 - len(value)) << 2, *head]) + value.ljust(4, b"\0"))
        else:
            self._transfer = _SegmentedTransfer(index, sub, value, up=True)
            self._reply(bytes([0x41, *head]) + len(value).to_bytes(4, "little"))

    def _upload_segment(self, data: bytes) -> None:
        transfer = self._require_segmented(up=True)
        if data[0] >> 4 & 1 != transfer.toggle:
            raise SdoAbort(aborts.TOGGLE)
        part, transfer.data = transfer.data[:SEGMENT_BYTES], transfer.data[SEGMENT_BYTES:]
        last = not transfer.data
        head = transfer.toggle << 4 | (SEGMENT_BYTES - len(part)) << 1 | last
        transfer.toggle ^= 1
        if last:
            self._transfer = None
        self._reply(bytes([head]) + part.ljust(SEGMENT_BYTES, b"\0"))

    def _require_segmented(self, *, up: bool) -> _SegmentedTransfer:
        transfer = self._transfer
        if not isinstance(transfer, _SegmentedTransfer) or transfer.up != up:
            raise SdoAbort(aborts.COMMAND)
        return transfer

    # Blocks to the client

    def _block_upload(self, data: bytes, index: int, sub: int) -> None:
        step = data[0] & 3
        if step == 0:
            value = self._dictionary.upload_value(index, sub)
            segments = data[4]
            if not 1 <= segments <= BLOCK_SEGMENTS:
                raise SdoAbort(aborts.BLOCK_SIZE)
            self._transfer = _BlockTransfer(index, sub, value, up=True, segments=segments, crc=bool(data[0] & 4))
            self._reply(bytes([0xC6, *data[1:4]]) + len(value).to_bytes(4, "little"))
            return
        transfer = self._require_block(up=True)
        if step == 3 and not transfer.begun:
            transfer.begun = True
            self._send_block(transfer)
        elif step == 2 and transfer.begun:
            self._acknowledge_block(transfer, data[1], data[2])
        elif step == 1 and transfer.ending:
            self._transfer = None
        else:
            raise SdoAbort(aborts.COMMAND)

    def _send_block(self, transfer: _BlockTransfer) -> None:
        for number in range(transfer.segments):
            begin = transfer.at + number * SEGMENT_BYTES
            last = begin + SEGMENT_BYTES >= len(transfer.data)
            part = transfer.data[begin : begin + SEGMENT_BYTES].ljust(SEGMENT_BYTES, b"\0")
            self._reply(bytes([(number + 1) | last << 7]) + part)
            transfer.sequence = number + 1
            if last:
                break

    def _acknowledge_block(self, transfer: _BlockTransfer, sequence: int, segments: int) -> None:
        if sequence > transfer.sequence:
            raise SdoAbort(aborts.SEQUENCE)
        if not 1 <= segments <= BLOCK_SEGMENTS:
            raise SdoAbort(aborts.BLOCK_SIZE)
        # Segments that the client has not received are sent again, together with those that follow.
        transfer.at += sequence * SEGMENT_BYTES
        transfer.segments = segments
        if transfer.at < len(transfer.data):
            self._send_block(transfer)
            return
        transfer.ending = True
        empty = transfer.at - len(transfer.data)
        crc = binascii.crc_hqx(transfer.data, 0) if transfer.crc else 0
        self._reply(bytes([0xC1 | empty << 2]) + crc.to_bytes(2, "little") + bytes(5))

    # Blocks from the client

    def _block_download(self, data: bytes, index: int, sub: int) -> None:
        if data[0] & 1:
            self._end_block_download(data)
            return
        entry = self._dictionary.find_entry(index, sub)
        if not entry.writable:
            raise SdoAbort(aborts.READ_ONLY)
        size = int.from_bytes(data[4:8], "little") if data[0] & 2 else None
        if size is not None and size > LONGEST_BYTES:
            raise SdoAbort(aborts.TOO_LONG)
        self._transfer = _BlockTransfer(index, sub, up=False, size=size, crc=bool(data[0] & 4), begun=True)
        self._reply(bytes([0xA4, *data[1:4], BLOCK_SEGMENTS, 0, 0, 0]))

    def _block_segment(self, transfer: _BlockTransfer, data: bytes) -> None:
        number, last = data[0] & 0x7F, data[0] >> 7
        if number == 0:
            raise SdoAbort(aborts.SEQUENCE)
        is_next = number == transfer.sequence + 1
        if is_next:
            transfer.sequence = number
            transfer.data += data[1:8]
        if len(transfer.data) > LONGEST_BYTES + SEGMENT_BYTES:
            raise SdoAbort(aborts.TOO_LONG)
        if last or number >= BLOCK_SEGMENTS:
            self._reply(bytes([0xA2, transfer.sequence, BLOCK_SEGMENTS, 0, 0, 0, 0, 0]))
            transfer.sequence = 0
            transfer.ending = bool(last) and is_next

    def _end_block_download(self, data: bytes) -> None:
        transfer = self._require_block(up=False)
        if not transfer.ending:
            raise SdoAbort(aborts.COMMAND)
        value = transfer.data[: len(transfer.data) - (data[0] >> 2 & 7)]
        if transfer.crc and int.from_bytes(data[1:3], "little") != binascii.crc_hqx(value, 0):
            raise SdoAbort(aborts.CRC)
        if transfer.size is not None and len(value) != transfer.size:
            raise SdoAbort(aborts.LENGTH)
        self._dictionary.download_value(transfer.index, transfer.sub, value)
        self._transfer = None
        self._reply(bytes([0xA1, 0, 0, 0, 0, 0, 0, 0]))

    def _require_block(self, *, up: bool) -> _BlockTransfer:
        transfer = self._transfer
        if not isinstance(transfer, _BlockTransfer) or transfer.up != up:
            raise SdoAbort(aborts.COMMAND)
        return transfer
