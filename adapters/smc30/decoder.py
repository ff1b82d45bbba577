"""The frames of a line of SMC30 in words: `[address] command [checksum] CR`, and replies without an address."""

from adapters.smc30.frames import ReplyReader, line_checksum
from adapters.toolkit.frames import (
    DecodedFrame,
    FrameDirection,
    LineCutter,
    PendingCommands,
    find_words,
    printable_text,
)

# docs/reference/controllers/smc30.md, sections 5 to 8
_WORDS = {
    "A": "activate output",
    "C": "clear output",
    "CR": "set run current",
    "CS": "set standby current",
    "CT": "set top current",
    "D": "delay",
    "E": "execute program",
    "F": "ask state",
    "G": "move to",
    "H": "search home",
    "I": "set counter or inputs",
    "J": "jump",
    "K": "stop at once",
    "M": "store in memory",
    "N": "arm condition",
    "PE": "program in memory",
    "PO": "program",
    "PX": "end programming",
    "Q": "list program",
    "R": "set ramp",
    "RS": "set ramp from start rate",
    "RT": "set ramp to top rate",
    "S": "set start rate",
    "T": "set top rate",
    "TP": "ask temperature",
    "U": "wait until input is on",
    "V1": "ask position",
    "V2": "ask inputs and outputs",
    "VA": "ask analogue inputs",
    "VR": "ask ramp or register",
    "VS": "ask start rate",
    "VT": "ask top rate",
    "W": "wait until input is off",
    "X": "recall from memory",
    "Z": "stop by ramp",
    "?": "end a half-typed line",
    "con=": "set conversion factor",
    "+": "move forward by",
    "-": "move backward by",
    "f": "set position counter",
    "g": "run",
}
_LONGEST = max(map(len, _WORDS))
_ERRORS = {
    "E1": "error: parity or checksum",
    "E2": "error: argument",
    "E3": "error: memory is full",
    "E4": "error: unknown command",
    "E5": "error: position counter or R, S, T",
    "E6": "error: permanent memory",
}
_REPLIES = {"Y": "accepted", "B": "busy", "R": "ready"}


class Smc30Decoder:
    """Frames of all controllers of a line; one exchange at a time."""

    def __init__(self, *, with_checksum: bool) -> None:
        self._with_checksum = with_checksum
        self._sent = LineCutter(b"\r")
        self._replies = ReplyReader(with_checksum=with_checksum)
        self._pending = PendingCommands()

    def decode_bytes(self, direction: FrameDirection, data: bytes) -> list[DecodedFrame]:
        if direction == "out":
            return [self._describe_sent(line) for line in self._sent.cut_lines(data)]
        frames: list[DecodedFrame] = []
        for reply in self._replies.feed_bytes(data, 0):
            # A reply follows the last command: an earlier one without a reply was lost.
            query = self._pending.take_answered()
            address, _, command = query.rpartition(" ")
            text = "" if reply.text is None else reply.text
            frames.append(DecodedFrame(text, self._describe_reply(reply.text, command), address))
        return frames

    def _describe_sent(self, line: bytes) -> DecodedFrame:
        has_checksum = self._with_checksum and len(line) > 1 and line[-1] == line_checksum(line[:-1])
        text = printable_text(line[:-1] if has_checksum else line)
        address, command = (text[:1], text[1:]) if text[:1].isdigit() else ("", text)
        self._pending.clear()
        self._pending.note_sent(f"{address} {command}")
        return DecodedFrame(command, find_words(command, _WORDS, _LONGEST), address)

    def _describe_reply(self, text: str | None, command: str) -> str:
        if text is None:
            return "garbled: parity or checksum"
        words = _ERRORS.get(text[:2]) or _REPLIES.get(text)
        if words:
            return f"{words}, to {command}" if command else words
        return f"answer to {command}" if command else "answer"
