"""The frames of a pp-electronic SMC in words: lines without number, of which only queries are answered."""

import re
from collections import deque

from adapters.ppsmc import replies as r
from adapters.toolkit.frames import DecodedFrame, TextDecoder, find_words

_QUERIES = {
    query.text: (query.form, words)
    for query, words in (
        (r.ASK_STATUS, "states"),
        (r.ASK_POSITIONS, "positions"),
        (r.ASK_ENCODERS, "encoder positions"),
        (r.ASK_ERRORS, "last errors"),
        (r.ASK_TARGETS, "target buffer"),
        (r.ASK_SETTINGS, "settings"),
        (r.ASK_VERSION, "version"),
        (r.ASK_PROGRAM, "program"),
        (r.ASK_INPUTS, "inputs"),
        (r.ASK_OUTPUTS, "outputs"),
        (r.ASK_USER_STATUS, "user status"),
    )
}
# By the letters before the axis number (docs/reference/controllers/ppsmc.md, sections 4 and 5).
_WORDS = {
    "acc": "set acceleration",
    "block": "block",
    "cerr": "clear errors",
    "conf": "set type",
    "dec": "set deceleration",
    "echo": "switch messages",
    "eref": "search encoder index",
    "fast": "jog fast",
    "ffast": "set top rate",
    "frun": "set start rate",
    "goto": "move to",
    "home": "home",
    "move": "move by",
    "org": "search reference",
    "out": "set outputs",
    "pos": "set position",
    "pqrf": "units in positions",
    "q": "stop by ramp",
    "quit": "stop by ramp",
    "ref": "search reference",
    "remote": "switch to remote",
    "run": "jog slowly",
    "set": "set outputs",
    "spin": "move continuously",
    "start": "start program",
    "tbc": "clear target buffer",
    "tbg": "go to buffered targets",
    "tbs": "set target in buffer",
    "txdel": "end of replies",
    "unblock": "unblock",
    "us": "set user status",
    "zero": "set zero",
}
_LONGEST = max(map(len, _WORDS))
_NAME = re.compile(r"\??[a-z]*", re.IGNORECASE)
_BITS = {
    r.StatusBits.READY: "ready",
    r.StatusBits.REFERENCED: "referenced",
    r.StatusBits.LIMIT_REVERSE: "reverse limit",
    r.StatusBits.LIMIT_FORWARD: "forward limit",
    r.StatusBits.PROGRAM: "program runs",
    r.StatusBits.IDLE: "idle",
    r.StatusBits.OSCILLATING: "oscillates",
    r.StatusBits.ENCODER_ERROR: "encoder error",
    r.StatusBits.BLOCKED: "blocked",
}


class PpSmcDecoder(TextDecoder):
    """A received line answers the oldest query whose format it has."""

    def __init__(self) -> None:
        super().__init__(b"\r\n\x02\x03")
        self._asked: deque[str] = deque(maxlen=100)

    def describe_sent(self, line: str) -> DecodedFrame:
        name_match = _NAME.match(line)
        name = name_match[0].lower() if name_match is not None else ""
        if name in _QUERIES:
            self._asked.append(name)
            return DecodedFrame(line, f"ask {_QUERIES[name][1]}")
        return DecodedFrame(line, _WORDS.get(name) or find_words(name, _WORDS, _LONGEST))

    def describe_received(self, line: str) -> DecodedFrame:
        while self._asked:
            form, words = _QUERIES[self._asked[0]]
            if form.matches_text(line):
                name = self._asked[0] if form.many else self._asked.popleft()
                return DecodedFrame(line, _describe_states(line) if name == r.ASK_STATUS.text else words)
            self._asked.popleft()
        return DecodedFrame(line, "version" if r.VERSION.matches_text(line) else "message")


def _describe_states(line: str) -> str:
    states = r.parse_states(line)
    words = {axis: " ".join(word for bit, word in _BITS.items() if bits & bit) for axis, bits in states.items()}
    return ", ".join(f"{axis} {text}" for axis, text in words.items())
