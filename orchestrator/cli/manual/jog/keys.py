"""A parser for key sequences of terminals: the legacy ones, and those of the kitty keyboard protocol, which reports
releases.

https://sw.kovidgoyal.net/kitty/keyboard-protocol/
"""

from dataclasses import dataclass
from typing import Literal

KeyKind = Literal["press", "repeat", "release"]

_ESC = 0x1B
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
# Keys without text, by their number in the kitty protocol; the keypad's arrows and signs count as the main ones.
_NUMBERED = {
    9: "tab",
    13: "enter",
    27: "escape",
    32: "space",
    127: "backspace",
    57412: "-",
    57413: "+",
    57417: "left",
    57418: "right",
    57419: "up",
    57420: "down",
} | {57399 + digit: str(digit) for digit in range(10)}
_CONTROLS = {0x08: "backspace", 0x09: "tab", 0x0A: "enter", 0x0D: "enter", 0x20: "space", 0x7F: "backspace"}
_EDITING = {"5": "pageup", "6": "pagedown"}  # by their number before `~`
_KINDS: dict[str, KeyKind] = {"": "press", "1": "press", "2": "repeat", "3": "release"}
_SHIFT, _ALT, _CTRL = 1, 2, 4
# Device control, operating system command and similar: text up to the string terminator.
_STRINGS = frozenset(b"PX]^_")
_MAX_SEQUENCE = 256  # no terminal sends a longer sequence; a longer one is garbage


@dataclass(frozen=True, slots=True)
class KeyEvent:
    """A key: an arrow by its name, `space`, `escape`, a character, or `ctrl+c`. Plain terminals report only presses."""

    name: str
    kind: KeyKind = "press"


@dataclass(frozen=True, slots=True)
class FocusChange:
    """The terminal's window got the keyboard focus (`on`), or lost it."""

    on: bool


@dataclass(frozen=True, slots=True)
class KeyboardFlags:
    """The reply of a terminal that supports the kitty protocol: the flags that are switched on now."""

    flags: int


@dataclass(frozen=True, slots=True)
class DeviceAttributes:
    """The reply that every terminal sends."""


TerminalEvent = KeyEvent | FocusChange | KeyboardFlags | DeviceAttributes


class KeyParser:
    """Parses bytes as they arrive, in any pieces. Unknown sequences are skipped."""

    def __init__(self) -> None:
        self._rest = b""

    @property
    def is_incomplete(self) -> bool:
        """Whether a sequence is incomplete. When nothing follows soon, call `expire_sequence`."""
        return bool(self._rest)

    def parse_bytes(self, data: bytes) -> list[TerminalEvent]:
        """Return the events that end with `data`, in order."""
        self._rest += data
        events: list[TerminalEvent] = []
        while self._rest:
            length, event = _parse_next(self._rest)
            if length == 0:
                if len(self._rest) <= _MAX_SEQUENCE:
                    break
                length = len(self._rest)
            self._rest = self._rest[length:]
            if event is not None:
                events.append(event)
        return events

    def expire_sequence(self) -> list[TerminalEvent]:
        """Treat the incomplete sequence as finished: it is the Escape key, or a sequence that was cut off."""
        is_alone, self._rest = self._rest == b"\x1b", b""
        return [KeyEvent("escape")] if is_alone else []


def _parse_next(data: bytes) -> tuple[int, TerminalEvent | None]:
    """Return the length of the first sequence in `data` (0: incomplete), and its event."""
    if data[0] != _ESC:
        return _parse_text(data)
    if len(data) == 1:
        return 0, None
    kind = data[1]
    if kind == ord("["):
        return _parse_control_sequence(data)
    if kind == ord("O"):
        return _parse_shifted_function(data)
    if kind in _STRINGS:
        return _skip_string(data)
    if kind == _ESC:
        return 1, KeyEvent("escape")
    length, key = _parse_text(data[1:])
    return (length + 1, KeyEvent(f"alt+{key.name}")) if length and key else (length and length + 1, None)


def _parse_text(data: bytes) -> tuple[int, KeyEvent | None]:
    """Parse a control character, or a character in UTF-8."""
    first = data[0]
    if first in _CONTROLS:
        return 1, KeyEvent(_CONTROLS[first])
    if first < 0x20:
        return 1, KeyEvent(f"ctrl+{chr(first + 0x60)}") if first <= 0x1A and first else None
    length = 1 if first < 0x80 else 2 if first >> 5 == 0b110 else 3 if first >> 4 == 0b1110 else 4
    part = data[:length]
    try:
        return length, KeyEvent(part.decode())
    except UnicodeDecodeError as error:
        cut_off = len(part) < length and error.end == len(part)
        return (0, None) if cut_off else (1, None)


def _parse_control_sequence(data: bytes) -> tuple[int, TerminalEvent | None]:
    """Parse ESC [, parameters, and a final character that selects the meaning."""
    for at in range(2, len(data)):
        if 0x40 <= data[at] <= 0x7E:
            return at + 1, _interpret_sequence(data[2:at].decode("ascii"), chr(data[at]))
        if not 0x20 <= data[at] <= 0x3F:
            return at, None
    return 0, None


def _interpret_sequence(parameters: str, final: str) -> TerminalEvent | None:
    if parameters.startswith("?"):
        if final == "u" and parameters[1:].isdecimal():
            return KeyboardFlags(int(parameters[1:]))
        return DeviceAttributes() if final == "c" else None
    if not parameters and final in "IO":
        return FocusChange(final == "I")
    code, _, more = parameters.partition(";")
    modifiers, _, event = more.partition(";")[0].partition(":")
    kind = _KINDS.get(event)
    if kind is None or (modifiers and not modifiers.isdecimal()):
        return None
    if final in _ARROWS:
        # With any modifiers: a Shift key that is released first must not hide the release of the arrow.
        return KeyEvent(_ARROWS[final], kind)
    if final == "~":
        return KeyEvent(_EDITING[code], kind) if code in _EDITING else None
    number = code.partition(":")[0]
    if final != "u" or not number.isdecimal():
        return None
    return _make_numbered_key(int(number), int(modifiers or 1) - 1, kind)


def _make_numbered_key(number: int, modifiers: int, kind: KeyKind) -> KeyEvent | None:
    """Return a key by its number in the kitty protocol, with Shift, Alt and Ctrl as bits."""
    name = _NUMBERED.get(number)
    if name is None:
        if not 0x20 < number < 0xE000:
            return None
        name = chr(number).upper() if modifiers & _SHIFT else chr(number)
    if modifiers & _CTRL:
        name = f"ctrl+{name}"
    elif modifiers & _ALT:
        name = f"alt+{name}"
    return KeyEvent(name, kind)


def _parse_shifted_function(data: bytes) -> tuple[int, TerminalEvent | None]:
    """Parse ESC O and one character: the arrows of a terminal in application mode."""
    if len(data) == 2:
        return 0, None
    name = _ARROWS.get(chr(data[2]))
    if not 0x20 <= data[2] <= 0x7E:
        return 2, None
    return 3, KeyEvent(name) if name else None


def _skip_string(data: bytes) -> tuple[int, None]:
    """Skip an unsolicited reply, up to its terminator. It must not be read as keys."""
    for at in range(2, len(data)):
        if data[at] == 0x07:
            return at + 1, None
        if data[at] == _ESC and at + 1 < len(data):
            return at + (2 if data[at + 1] == ord("\\") else 0), None
    return 0, None
