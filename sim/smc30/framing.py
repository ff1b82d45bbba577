"""Strings on the serial line: address, checksum and parity (L875-L1087, L1538-L1541)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

_CR = 13
_SEVEN_BITS = 0x7F
_PARITY_BIT = 0x80


def compute_checksum(text: bytes) -> int:
    """Sum of the character codes modulo 128 (L1066-L1081)."""
    return sum(text) % 128


def odd_parity(data: bytes) -> bytes:
    """Return `data` with bit 7 set wherever the other seven bits have even parity."""
    return bytes(byte if byte.bit_count() % 2 else byte | _PARITY_BIT for byte in data)


@dataclass(frozen=True, slots=True)
class ReceivedString:
    """One string for this device, without address and checksum.

    intact: no parity or checksum error, not too long."""

    text: str
    intact: bool = True


@dataclass(slots=True)
class StringReader:
    """Splits the bytes on the line into the strings addressed to one device.

    A string ends with CR only; there is no timeout, a partial string waits for its other part. Strings with another
    address are ignored silently (L879-L881).
    """

    address: int
    checksum: bool
    limit: int
    parity: Literal["stripped", "wire"]
    _text: bytearray = field(default_factory=bytearray)
    _spoilt: bool = False
    """A character of this string had a parity error."""
    _stranger: bool = False
    """Its first character had a parity error: the string is addressed to no device."""
    _held: bytes | None = None
    """A string whose checksum would be CR: the next CR may be that checksum (decision 3)."""

    def read_strings(self, data: bytes) -> Iterator[ReceivedString]:
        """Yield the strings that `data` completes."""
        if self.parity == "stripped" and data.isascii():
            *complete, tail = data.split(b"\r")
            for piece in complete:
                self._append_piece(piece)
                yield from self._complete_strings()
            self._append_piece(tail)
            return
        for byte in data:
            good = byte.bit_count() % 2 == 1 if self.parity == "wire" else byte < _PARITY_BIT
            if not good:
                self._spoilt = True
                self._stranger = self._stranger or not self._text
            if byte & _SEVEN_BITS == _CR:
                yield from self._complete_strings()
            else:
                self._append_piece(bytes((byte & _SEVEN_BITS,)))

    def discard_partial(self) -> None:
        """Discard a partial string."""
        self._text.clear()
        self._spoilt = self._stranger = False
        self._held = None

    def _append_piece(self, piece: bytes) -> None:
        # One character above the limit is enough to detect it; LF after CR is not part of a string (decision 5).
        if not self._text:
            piece = piece.lstrip(b"\n")
        self._text += piece[: self.limit + 1 - len(self._text)]

    def _complete_strings(self) -> Iterator[ReceivedString]:
        text, spoilt, stranger = bytes(self._text), self._spoilt, self._stranger
        piece, self._held = self._held, None
        self._text.clear()
        self._spoilt = self._stranger = False
        if piece is not None:
            if not text and not spoilt:
                yield self._decode_string(piece)
                return
            yield ReceivedString("", intact=False)
        if self.address:
            if stranger or not text.startswith(b"%d" % self.address):
                return
        elif not text and not spoilt and self.checksum:
            return
        if spoilt or len(text) > self.limit:
            yield ReceivedString("", intact=False)
        elif not self.checksum:
            yield self._decode_string(text)
        elif len(text) > bool(self.address) and text[-1] == compute_checksum(text[:-1]):
            yield self._decode_string(text[:-1])
        elif compute_checksum(text) == _CR:
            self._held = text
        else:
            yield ReceivedString("", intact=False)

    def _decode_string(self, text: bytes) -> ReceivedString:
        return ReceivedString(text[1 if self.address else 0 :].decode("ascii"))
