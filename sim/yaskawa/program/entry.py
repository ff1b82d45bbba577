"""Operator data entry: input received on a serial port, for the keywords `PxCD PxCH PxST PxNM`.

SMC-4000: L12105; SMC-2000: L4807-L4845.
"""

from sim.yaskawa.base import fixed

DISABLED, NOTHING, CHARACTER, STRING, NUMBER = -1, 0, 1, 2, 3


class OperatorEntry:
    """One port's buffer. While disabled it stores the last character only."""

    def __init__(self) -> None:
        self.code = DISABLED
        self._typed = ""
        self._values: dict[str, int] = {"CH": 0, "ST": 0, "NM": 0}

    @property
    def is_enabled(self) -> bool:
        """Whether the port is in operator data mode: its characters are not commands."""
        return self.code != DISABLED

    def set_enabled(self, *, on: bool) -> None:
        """Enter or leave the mode."""
        self.clear_input()
        self.code = NOTHING if on else DISABLED

    def clear_input(self) -> None:
        """Discard the input."""
        self._typed = ""
        if self.is_enabled:
            self.code = NOTHING

    def note_characters(self, text: str) -> None:
        """Store characters of a port that accepts commands: the code reports that one arrived (SMC-4000: L12110)."""
        self._values["CH"] = fixed.from_integer(ord(text[-1]) if text else 0)
        self.code = CHARACTER

    def take_character(self, character: str) -> None:
        """Process a character in operator data mode; carriage return ends a string or a number."""
        self._values["CH"] = fixed.from_string(character)
        if character != "\r":
            self._typed += character
            self.code = CHARACTER
            return
        text, self._typed = self._typed, ""
        self._values["ST"] = fixed.from_string(text[: fixed.STRING_LENGTH])
        try:
            sign = -1 if text.startswith("-") else 1
            self._values["NM"] = sign * fixed.parse_literal(text.removeprefix("-"))
            self.code = NUMBER
        except ValueError:
            self.code = STRING

    def read_item(self, item: str) -> int:
        """Return a keyword's value; reading an available string or number resets the code (SMC-2000: L4844)."""
        if item == "CD":
            return fixed.from_integer(self.code)
        if (item, self.code) in (("ST", STRING), ("NM", NUMBER)):
            self.code = NOTHING
        return self._values[item]
