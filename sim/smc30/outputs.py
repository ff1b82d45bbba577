"""User outputs 1-3 (L553-L591)."""

from collections.abc import Callable

USER_OUTPUTS = 3


class Outputs:
    """Levels of the outputs; listeners hear of every change."""

    def __init__(self) -> None:
        self._levels = [False] * (USER_OUTPUTS + 1)
        self.listeners: list[Callable[[int, bool], None]] = []

    def level(self, number: int) -> bool:
        return self._levels[number]

    def set(self, number: int, on: bool) -> None:
        if self._levels[number] == on:
            return
        self._levels[number] = on
        for listener in self.listeners:
            listener(number, on)

    def clear(self) -> None:
        for number in range(1, USER_OUTPUTS + 1):
            self.set(number, False)

    def pattern(self) -> int:
        """Bit value 1 = output 1, 2 = output 2, 4 = output 3."""
        return sum(1 << (number - 1) for number in range(1, USER_OUTPUTS + 1) if self._levels[number])
