"""Designators `~a` to `~d` of axes (L7780-L7811)."""

from sim.yaskawa.base.errors import CommandError

_AXIS_NUMBERS = {0: "X", 1: "Y", 2: "Z", 3: "W", 8: "S", 9: "T", 10: "N"}


class AxisDesignators:
    """The axis, or the system, that each designator names."""

    def __init__(self) -> None:
        self._letters: dict[str, str] = {}

    def resolve_name(self, name: str, *, unset: str = "") -> str:
        """Return the letter that a designator names, `unset` before it is given; another name as it is."""
        return self._letters.get(name, unset) if name.startswith("~") else name

    def name_axis(self, designator: str, letter: str) -> None:
        """`~a="X"`."""
        if letter not in _AXIS_NUMBERS.values():
            raise CommandError(4)
        self._letters[designator] = letter

    def designator_number(self, designator: str) -> int:
        """Return the value of `~a` as a number (L7811); 4 before it is given."""
        letter = self._letters.get(designator)
        if letter is None:
            raise CommandError(4)
        return next(number for number, name in _AXIS_NUMBERS.items() if name == letter)

    def number_axis(self, designator: str, number: int) -> None:
        """`~a=2`."""
        if number not in _AXIS_NUMBERS:
            raise CommandError(6)
        self._letters[designator] = _AXIS_NUMBERS[number]
