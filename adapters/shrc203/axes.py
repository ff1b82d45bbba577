"""Axis letters: the notation of the SHRC-203's commands for one or several axes (L3109-L3117)."""

from collections.abc import Iterable

_LETTERS: dict[tuple[int, ...], str] = {
    (1,): "1",
    (2,): "2",
    (3,): "3",
    (1, 2): "A",
    (1, 3): "B",
    (2, 3): "C",
    (1, 2, 3): "D",
}

# The reply of `?:AXIS`: which axes are controllable (L2206-L2222).
CONTROLLABLE = {"0": (1,), "1": (2,), "2": (3,), "3": (1, 2), "4": (1, 3), "5": (2, 3), "6": (1, 2, 3)}


def axis_argument(motors: Iterable[int]) -> str:
    """Return the axis argument that denotes exactly `motors` (one to three of 1, 2, 3)."""
    return _LETTERS[tuple(sorted(set(motors)))]
