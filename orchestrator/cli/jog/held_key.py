"""Detection of a held key: hold-to-run control from the key events of a terminal.

Where the terminal reports releases, a release ends the hold immediately. The terminal must also keep reporting key
events, at least repeats of the held key: over a connection that hangs no release would ever arrive.

A plain terminal only repeats a held key. A first press is a tap, because repeats begin 250 to 660 ms later; from the
first repeat on the key counts as held until no repeat has arrived for `WAIT_NS`.
"""

from enum import Enum

from orchestrator.cli.jog.keys import Key
from orchestrator.clock.base import NS_PER_MS

TAP_NS = 200 * NS_PER_MS  # the validity of one jog request
# Repeats come at 25 to 40 Hz, on some systems by default at 11 Hz: at the higher rates one may be missing.
WAIT_NS = 120 * NS_PER_MS
BEGIN_NS = 800 * NS_PER_MS  # the slowest common delay before repeats begin is 660 ms
GAP_NS = 250 * NS_PER_MS  # between repeats: a key without events for longer has been released
SILENT_NS = 1000 * NS_PER_MS  # with releases reported: longer than the slowest delay before repeats


class Grip(Enum):
    """A change of the held key."""

    BEGIN = "pressed"
    GO_ON = "it counted as a tap, or as released, and is held after all"
    END = "released"
    SILENT = "the terminal sends nothing more"


class Hold:
    """Tracks one held key. `releases`: the terminal reports them. Instants in ns on any clock."""

    def __init__(self, releases: bool) -> None:
        self.releases = releases
        self.key: str | None = None
        self.until_ns: int | None = None
        self._last = ""
        self._last_ns = 0
        self._repeats = False

    def take(self, key: Key, now_ns: int) -> Grip | None:
        """Handle an event of a key that can be held."""
        return self._reported(key, now_ns) if self.releases else self._guessed(key.name, now_ns)

    def alive(self, now_ns: int) -> None:
        """Note an event of another key: the terminal is connected."""
        if self.releases and self.key is not None:
            self.until_ns = now_ns + SILENT_NS

    def look(self, now_ns: int) -> Grip | None:
        """Return the change that follows from the time passed."""
        if self.until_ns is None or now_ns < self.until_ns:
            return None
        self.drop()
        return Grip.SILENT if self.releases else Grip.END

    def drop(self) -> None:
        """Treat the key as released, whatever events follow."""
        self.key = self.until_ns = None

    def _reported(self, key: Key, now_ns: int) -> Grip | None:
        if key.kind == "press":
            self.key, self.until_ns = key.name, now_ns + SILENT_NS
            return Grip.BEGIN
        self.alive(now_ns)
        if key.kind == "release" and key.name == self.key:
            self.drop()
            return Grip.END
        return None

    def _guessed(self, name: str, now_ns: int) -> Grip | None:
        silent_ns = now_ns - self._last_ns
        again = name == self._last and silent_ns <= (GAP_NS if self._repeats else BEGIN_NS)
        held = self.key == name
        self.key = self._last = name
        self._last_ns = now_ns
        self._repeats = again
        if not again:
            self.until_ns = now_ns + TAP_NS
            return Grip.BEGIN
        self.until_ns = max(self.until_ns or 0, now_ns + WAIT_NS)
        return None if held else Grip.GO_ON
