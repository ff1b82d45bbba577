"""Operator data entry: what came in on a serial port, for the keywords `PxCD PxCH PxST PxNM`.

SMC-4000: L12105; SMC-2000: L4807-L4845.
"""

from sim.yaskawa.base import fixed

DISABLED, NOTHING, CHARACTER, STRING, NUMBER = -1, 0, 1, 2, 3


class OperatorEntry:
    """One port's buffer. While disabled it remembers the last character only."""

    def __init__(self) -> None:
        self.code = DISABLED
        self._typed = ""
        self._values: dict[str, int] = {"CH": 0, "ST": 0, "NM": 0}

    @property
    def enabled(self) -> bool:
        """Whether the port is in operator data mode: its characters are no commands."""
        return self.code != DISABLED

    def enable(self, on: bool) -> None:
        """Enter or leave the mode."""
        self.clear()
        self.code = NOTHING if on else DISABLED

    def clear(self) -> None:
        """Forget what was typed."""
        self._typed = ""
        if self.enabled:
            self.code = NOTHING

    def notice(self, text: str) -> None:
        """Characters of a port on which commands are understood: the code tells that one came (SMC-4000: L12110)."""
        self._values["CH"] = fixed.whole(ord(text[-1]) if text else 0)
        self.code = CHARACTER

    def take(self, character: str) -> None:
        """A character in operator data mode; carriage return ends a string or a number."""
        self._values["CH"] = fixed.of_string(character)
        if character != "\r":
            self._typed += character
            self.code = CHARACTER
            return
        typed, self._typed = self._typed, ""
        self._values["ST"] = fixed.of_string(typed[: fixed.STRING_LENGTH])
        try:
            sign = -1 if typed.startswith("-") else 1
            self._values["NM"] = sign * fixed.literal(typed.removeprefix("-"))
            self.code = NUMBER
        except ValueError:
            self.code = STRING

    def read(self, item: str) -> int:
        """A keyword's value; reading a string or number that is there sets the code back (SMC-2000: L4844)."""
        if item == "CD":
            return fixed.whole(self.code)
        if (item, self.code) in (("ST", STRING), ("NM", NUMBER)):
            self.code = NOTHING
        return self._values[item]
