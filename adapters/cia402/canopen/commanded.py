"""The commanded position of a drive that does not report it: 6062h is optional.

At rest a drive holds the target that it was given last, or the place where it has come to rest. Its actual position is
near that, and varies by some counts. So the held position stays until the actual one is further away.
"""


class CommandedPosition:
    """The commanded position of one drive, by its actual position. window: how far it may be from a position that it
    holds, counts."""

    def __init__(self, window: int) -> None:
        self._window = window
        self._held: int | None = None
        self._target: int | None = None

    def begin_motion(self, target: int) -> None:
        """Record that a motion to `target` has begun."""
        self._target, self._held = target, None

    def rest_at(self, actual: int) -> None:
        """Record that a motion was ended at `actual`, wherever it was to go."""
        self._target, self._held = None, actual

    def estimate(self, actual: int) -> int:
        """Return the commanded position, counts."""
        for counts in (self._target, self._held):
            if counts is not None and abs(actual - counts) <= self._window:
                self._held = counts
                return counts
        self._held = actual
        return actual
