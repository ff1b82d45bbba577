"""Variables and arrays (L15700-L15960)."""

import re
from dataclasses import dataclass

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError

LONGEST_LINE = 80
"""Characters of a command with its arguments, and of a program's line (L12254)."""
ARRAYS = 30
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]{0,7}")


@dataclass(frozen=True, slots=True)
class MemoryCapacity:
    """Capacity of a controller."""

    lines: int
    labels: int
    variables: int
    elements: int
    """Total of all arrays."""
    zero_frees: bool = False
    """`DM NAME[0]` frees an array (L15912; SMC-2000: L4500)."""


class VariableStore:
    """All variables and arrays of one controller, shared by its threads and ports."""

    def __init__(self, room: MemoryCapacity) -> None:
        self.room = room
        self.variables: dict[str, int] = {}
        self.arrays: dict[str, list[int]] = {}

    def read_variable(self, name: str) -> int:
        try:
            return self.variables[name]
        except KeyError:
            raise CommandError(9) from None

    def assign_variable(self, name: str, raw: int) -> None:
        """Set a variable; the first assignment creates it (L14457)."""
        if name not in self.variables:
            if _NAME.fullmatch(name) is None:
                raise CommandError(9)
            if len(self.variables) >= self.room.variables:
                raise CommandError(67)
        self.variables[name] = raw

    def get_array(self, name: str) -> list[int]:
        try:
            return self.arrays[name]
        except KeyError:
            raise CommandError(82) from None

    def read_element(self, name: str, index: int) -> int:
        array = self.get_array(name)
        if not 0 <= index < len(array):
            raise CommandError(56)
        return array[index]

    def store_element(self, name: str, index: int, raw: int) -> None:
        array = self.get_array(name)
        if not 0 <= index < len(array):
            raise CommandError(56)
        array[index] = raw

    def free_elements(self) -> int:
        return self.room.elements - sum(len(array) for array in self.arrays.values())

    def create_array(self, name: str, size: int, *, proper: bool = False) -> None:
        """`DM`: create an array of zeros; an existing one of that name is replaced.

        proper: names begin with a capital."""
        if _NAME.fullmatch(name) is None or (proper and not name[0].isupper()):
            raise CommandError(57)
        if size == 0 and self.room.zero_frees and name in self.arrays:
            del self.arrays[name]
            return
        if size < 1:
            raise CommandError(6)
        size_before = len(self.arrays.get(name, ()))
        if name not in self.arrays and len(self.arrays) >= ARRAYS:
            raise CommandError(67)
        if size > self.free_elements() + size_before:
            raise CommandError(66)
        self.arrays[name] = [0] * size

    def delete_name(self, name: str) -> None:
        """`DA`: delete a variable, or an array when brackets follow (L3971)."""
        if name == "**[0]":
            self.variables.clear()
            self.arrays.clear()
        elif name == "*":
            self.variables.clear()
        elif name.startswith("*["):
            self.arrays.clear()
        elif name.endswith("]"):
            self.arrays.pop(name.partition("[")[0], None)
        else:
            self.variables.pop(name, None)

    def list_variables(self) -> list[str]:
        """Return the lines of `LV` (L7223)."""
        lines: list[str] = []
        for name in sorted(self.variables):
            raw = self.variables[name]
            number = fixed.round_half_up(abs(raw) * 10000 / fixed.ONE)
            lines.append(f"{name} = {'-' if raw < 0 else ''}{number // 10000}.{number % 10000:04d}")
        return lines

    def list_arrays(self) -> list[str]:
        """Return the lines of `LA` (L6726)."""
        return [f"{name} [{len(self.arrays[name])}]" for name in sorted(self.arrays)]
