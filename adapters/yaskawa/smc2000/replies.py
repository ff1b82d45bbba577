"""Replies on a serial line, where a controller that was reset echoes its input (EO, L8573)."""

from dataclasses import dataclass

PROMPT, REFUSAL = 0x3A, 0x3F  # : and ?


@dataclass(frozen=True, slots=True)
class SerialReply:
    """A complete reply at the start of a buffer, `used` bytes of it. echoed: the reply contains the command's echo."""

    lines: list[str]
    refused: bool
    echoed: bool
    used: int


def parse_serial_reply(buffer: bytes | bytearray) -> SerialReply | None:
    """Return the first complete reply in `buffer`, or None: data lines, each ended by CR LF, then a prompt
    (L1003-1007).

    The echo of a command ends with CR alone, because nothing is added to it. A stray line end, and the control Z that
    ends a listing, are skipped. `?` and a digit is not a prompt but the report of a program's error (L3473).
    """
    lines: list[str] = []
    at, size, is_echoed = 0, len(buffer), False
    while at < size:
        first = buffer[at]
        if first in b"\r\n\x1a":
            at += 1
        elif first == PROMPT:
            return SerialReply(lines, refused=False, echoed=is_echoed, used=at + 1)
        elif first == REFUSAL and not buffer[at + 1 : at + 2].isdigit():
            return SerialReply(lines, refused=True, echoed=is_echoed, used=at + 1)
        else:
            end = buffer.find(b"\r", at)
            if end < 0 or end + 1 == size:
                return None
            if buffer[end + 1] == 0x0A:
                lines.append(buffer[at:end].decode("latin-1").strip())
                at = end + 2
            else:
                is_echoed = True
                at = end + 1
    return None
