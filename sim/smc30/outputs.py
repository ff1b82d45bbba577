"""User outputs 1-3 (L553-L591)."""

from collections.abc import Callable

USER_OUTPUTS = 3


class UserOutputs:
    """Levels of the outputs; listeners are called on every change."""

    def __init__(self) -> None:
        self._levels = [False] * (USER_OUTPUTS + 1)
        self.listeners: list[Callable[[int, bool], None]] = []

    def output_level(self, number: int) -> bool:
        return self._levels[number]

    def set_output(self, number: int, *, on: bool) -> None:
        if self._levels[number] == on:
            return
        self._levels[number] = on
        for listener in self.listeners:
            listener(number, on)

    def clear_outputs(self) -> None:
        for number in range(1, USER_OUTPUTS + 1):
            self.set_output(number, on=False)

    def output_pattern(self) -> int:
        """Bit value 1 = output 1, 2 = output 2, 4 = output 3."""
        return sum(1 << (number - 1) for number in range(1, USER_OUTPUTS + 1) if self._levels[number])
