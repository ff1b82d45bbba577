"""Strings on the serial line: address, checksum and parity (L875-L1087, L1538-L1541)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

_CR = 13
_SEVEN_BITS = 0x7F
_PARITY_BIT = 0x80


def checksum(text: bytes) -> int:
    """Sum of the character codes modulo 128 (L1066-L1081)."""
    return sum(text) % 128


def odd_parity(data: bytes) -> bytes:
    """`data` with bit 7 set wherever the seven others are even in number."""
    return bytes(byte if byte.bit_count() % 2 else byte | _PARITY_BIT for byte in data)


@dataclass(frozen=True, slots=True)
class Received:
    """One string for this unit, without address and checksum. intact: no parity or checksum error, not too long."""

    text: str
    intact: bool = True


@dataclass(slots=True)
class StringReader:
    """Cuts what one unit sees on the line into the strings that are meant for it.

    A string ends with CR only; there is no time-out, half a string waits for its other half. Strings with another
    address are passed over in silence (L879-L881).
    """

    address: int
    checksum: bool
    limit: int
    parity: Literal["stripped", "wire"]
    _text: bytearray = field(default_factory=bytearray)
    _spoilt: bool = False
    """A character of this string came with a parity error."""
    _stranger: bool = False
    """Its first character did: nobody can be meant."""
    _held: bytes | None = None
    """A string whose checksum would be CR: the next CR may be it (decision 3)."""

    def feed(self, data: bytes) -> Iterator[Received]:
        """The strings that `data` completes."""
        if self.parity == "stripped" and data.isascii():
            *complete, rest = data.split(b"\r")
            for piece in complete:
                self._keep(piece)
                yield from self._complete()
            self._keep(rest)
            return
        for byte in data:
            good = byte.bit_count() % 2 == 1 if self.parity == "wire" else byte < _PARITY_BIT
            if not good:
                self._spoilt = True
                self._stranger = self._stranger or not self._text
            if byte & _SEVEN_BITS == _CR:
                yield from self._complete()
            else:
                self._keep(bytes((byte & _SEVEN_BITS,)))

    def clear(self) -> None:
        """Forget half a string."""
        self._text.clear()
        self._spoilt = self._stranger = False
        self._held = None

    def _keep(self, piece: bytes) -> None:
        # One more than would be too long is enough to know; LF after CR is no part of a string (decision 5).
        if not self._text:
            piece = piece.lstrip(b"\n")
        self._text += piece[: self.limit + 1 - len(self._text)]

    def _complete(self) -> Iterator[Received]:
        text, spoilt, stranger = bytes(self._text), self._spoilt, self._stranger
        held, self._held = self._held, None
        self._text.clear()
        self._spoilt = self._stranger = False
        if held is not None:
            if not text and not spoilt:
                yield self._received(held)
                return
            yield Received("", intact=False)
        if self.address:
            if stranger or not text.startswith(b"%d" % self.address):
                return
        elif not text and not spoilt and self.checksum:
            return
        if spoilt or len(text) > self.limit:
            yield Received("", intact=False)
        elif not self.checksum:
            yield self._received(text)
        elif len(text) > bool(self.address) and text[-1] == checksum(text[:-1]):
            yield self._received(text[:-1])
        elif checksum(text) == _CR:
            self._held = text
        else:
            yield Received("", intact=False)

    def _received(self, text: bytes) -> Received:
        return Received(text[1 if self.address else 0 :].decode("ascii"))
