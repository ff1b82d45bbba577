"""The frames of SMC-4000, SMC-2000 and Galil controllers in words: command lines, and replies up to their prompt."""

import re
from collections.abc import Callable, Sequence
from typing import Protocol

from adapters.toolkit.frames import (
    DecodedFrame,
    FrameDirection,
    LineCutter,
    PendingCommands,
    printable_text,
)
from adapters.yaskawa.language.dialect import split_commands

_WORDS = {
    "AB": "abort",
    "AC": "acceleration",
    "AD": "after distance",
    "AI": "after input",
    "AL": "arm latch",
    "AM": "after motion",
    "AP": "after absolute position",
    "BG": "begin motion",
    "BN": "burn parameters",
    "CB": "clear output",
    "CD": "contour data",
    "CE": "configure encoder",
    "CF": "route of unsolicited output",
    "CM": "contour mode",
    "CW": "mark unsolicited output",
    "DA": "deallocate array",
    "DC": "deceleration",
    "DE": "define auxiliary position",
    "DL": "download program",
    "DM": "dimension array",
    "DP": "define position",
    "DT": "contour time",
    "DV": "dual loop",
    "EB": "electronic cam",
    "EO": "echo",
    "ER": "error limit",
    "FA": "acceleration feedforward",
    "FE": "find edge",
    "FI": "find index",
    "FL": "forward soft limit",
    "FV": "velocity feedforward",
    "GR": "gear ratio",
    "HM": "home",
    "HX": "halt program",
    "IL": "integrator limit",
    "IT": "smoothing",
    "JG": "jog",
    "KD": "derivative gain",
    "KI": "integral gain",
    "KP": "proportional gain",
    "KS": "step smoothing",
    "LA": "list arrays",
    "LS": "list program",
    "LV": "list variables",
    "LZ": "leading zeros",
    "MG": "print values",
    "MO": "motor off",
    "MT": "motor type",
    "OB": "output",
    "OE": "off on error",
    "OF": "offset",
    "OP": "output port",
    "PA": "absolute position",
    "PF": "position format",
    "PR": "relative position",
    "QD": "download array",
    "QR": "ask data record",
    "QU": "upload array",
    "QZ": "ask record sizes",
    "RL": "report latch",
    "RP": "tell commanded position",
    "RS": "reset",
    "SB": "set output",
    "SC": "tell stop code",
    "SH": "servo here",
    "SP": "speed",
    "ST": "stop",
    "TB": "tell status byte",
    "TC": "tell error code",
    "TE": "tell position error",
    "TI": "tell inputs",
    "TK": "peak torque limit",
    "TL": "torque limit",
    "TM": "sample time",
    "TP": "tell position",
    "TS": "tell switches",
    "TT": "tell torque",
    "TV": "tell velocity",
    "TW": "in-position time",
    "UL": "upload program",
    "VF": "variable format",
    "WH": "which handle",
    "WT": "wait",
    "XQ": "execute program",
}
_SPECIAL = {
    "\\x12\\x15": "ask firmware revision",
    "\\x12\\x16": "ask firmware revision",
    "\\x12\\x13": "master reset",
    "\\\\": "flush the line",
}
_ADDRESS = re.compile(r"%([0-9A-F])")
_SETS = re.compile(r"[A-Za-z]\w*(\[[^\]]*\])?=")
_ENDS = ("\\x1a", "\\\\")  # of a download, as printable text
_MARKER = re.compile(r"<\w+>")
_MARK = 0x80  # CW 1: program output has bit 7
MAX_REPLY_LINES = 4  # that are shown: of a listing, the first ones
MAX_REPLY_BYTES = 2000 * 82  # a listing of the largest program (L12254); what is longer is no reply
MAX_COMMAND = 24  # characters of a command in the meaning of its answer
_RECORD_BYTES = range(8, 1001)


class PromptedReply(Protocol):
    """A reply up to its prompt, at the start of a buffer."""

    @property
    def lines(self) -> list[str]: ...

    @property
    def refused(self) -> bool: ...

    @property
    def used(self) -> int: ...


class YaskawaDecoder:
    """parse: the parser of replies of the session. marked: program output has bit 7 set, and is separated."""

    def __init__(self, parse: Callable[[bytes], PromptedReply | None], *, marked: bool = False) -> None:
        self._parse = parse
        self._marked = marked
        self._sent = LineCutter(b"\r")
        self._output = LineCutter()
        self._buffer = b""
        self._pending = PendingCommands()
        self._address = ""
        self._loads = False

    def decode_bytes(self, direction: FrameDirection, data: bytes) -> list[DecodedFrame]:
        if direction == "out":
            return [self._describe_sent(printable_text(line)) for line in self._sent.cut_lines(data)]
        frames: list[DecodedFrame] = []
        if self._marked:
            output = bytes(byte & ~_MARK for byte in data if byte & _MARK)
            data = bytes(byte for byte in data if not byte & _MARK)
            lines = self._output.cut_lines(output)
            frames = [DecodedFrame(printable_text(line).strip(), "program output", self._address) for line in lines]
        self._buffer += data
        while (reply := self._take_reply()) is not None:
            frames.append(reply)
        return frames

    # Commands

    def _describe_sent(self, line: str) -> DecodedFrame:
        if (address_match := _ADDRESS.fullmatch(line)) is not None:
            self._address = address_match[1]
            self._pending.note_sent(line)
            return DecodedFrame(line, f"select controller {address_match[1]}", self._address)
        if self._loads:
            # Only the end of a download is answered.
            self._loads = not any(end in line for end in _ENDS)
            return DecodedFrame(line, "download" if self._loads else "end of download", self._address)
        self._loads = line.startswith(("DL", "QD"))
        commands = [command.strip() for command in split_commands(line)]
        for command in commands:
            if command:
                self._pending.note_sent(command)
        words = dict.fromkeys(_describe_command(command) for command in commands)
        return DecodedFrame(line, ", ".join(word for word in words if word), self._address)

    # Replies

    def _take_reply(self) -> DecodedFrame | None:
        record = self._find_record()
        if record is not None:
            self._buffer = self._buffer[len(record) + 1 :]
            self._pending.take_answered()
            sample = int.from_bytes(record[4:6], "little")
            return DecodedFrame(f"{len(record)} bytes", f"data record of sample {sample}", self._address)
        reply = self._parse(self._buffer) if not self._awaits_record() else None
        if reply is None:
            if len(self._buffer) <= MAX_REPLY_BYTES:
                return None
            text, self._buffer = self._buffer, b""
            return DecodedFrame(printable_text(text), "no reply", self._address)
        self._buffer = self._buffer[reply.used :]
        command = self._take_command(reply.lines)
        text = " / ".join(printable_text(line.encode("latin-1")) for line in reply.lines[:MAX_REPLY_LINES])
        if len(reply.lines) > MAX_REPLY_LINES:
            text += f" … {len(reply.lines)} lines"
        meaning = _describe_reply(reply.lines, command, refused=reply.refused)
        return DecodedFrame(text or ":?"[reply.refused], meaning, self._address)

    def _take_command(self, lines: Sequence[str]) -> str:
        """The command that is answered. A session's marker, which is printed back, shows which one that is, although
        replies before it were missing or superfluous."""
        command = self._pending.take_answered()
        marker = _MARKER.match(lines[-1]) if lines else None
        while marker is not None and command and marker[0] not in command:
            command = self._pending.take_answered()
        return command

    def _record_size(self) -> int | None:
        """The size by the header of a data record; None for anything else (L8697: blocks, bit 15 set; size)."""
        if len(self._buffer) < 4 or not self._buffer[1] & _MARK:
            return None
        size = int.from_bytes(self._buffer[2:4], "little")
        return size if size in _RECORD_BYTES else None

    def _awaits_record(self) -> bool:
        size = self._record_size()
        return size is not None and len(self._buffer) <= size

    def _find_record(self) -> bytes | None:
        size = self._record_size()
        if size is None or self._buffer[size : size + 1] != b":":
            return None
        return self._buffer[:size]


def _describe_command(command: str) -> str:
    if command in _SPECIAL:
        return _SPECIAL[command]
    words = _WORDS.get(command[:2], "")
    if not words and _SETS.match(command):
        return f"set {command.partition('=')[0]}"
    return words


def _describe_reply(lines: Sequence[str], command: str, *, refused: bool) -> str:
    command_text = f" {command[:MAX_COMMAND]}" if command else ""
    if refused:
        return f"refused{':' if command_text else ''}{command_text}"
    if not lines:
        return f"accepted{':' if command_text else ''}{command_text}"
    return f"answer to{command_text}" if command_text else "answer"
