"""Detection of a held key: hold-to-run control from the key events of a terminal.

Where the terminal reports releases, a release ends the hold immediately. The terminal must also keep reporting key
events, at least repeats of the held key: over a connection that hangs no release would ever arrive.

A plain terminal only repeats a held key. A first press is a tap, because repeats begin 250 to 660 ms later; from the
first repeat on the key counts as held until no repeat has arrived for `REPEAT_WAIT_NS`.
"""

from enum import Enum

from orchestrator.cli.manual.jog.keys import KeyEvent
from orchestrator.clock.base import NS_PER_MS

TAP_NS = 200 * NS_PER_MS  # the validity of one jog request
# Repeats come at 25 to 40 Hz, on some systems by default at 11 Hz: at the higher rates one may be missing.
REPEAT_WAIT_NS = 120 * NS_PER_MS
REPEAT_DELAY_NS = 800 * NS_PER_MS  # the slowest common delay before repeats begin is 660 ms
REPEAT_GAP_NS = 250 * NS_PER_MS  # between repeats: a key without events for longer has been released
SILENCE_NS = 1000 * NS_PER_MS  # with releases reported: longer than the slowest delay before repeats


class KeyChange(Enum):
    """A change of the held key."""

    BEGIN = "pressed"
    GO_ON = "it counted as a tap, or as released, and is held after all"
    END = "released"
    SILENT = "the terminal sends nothing more"


class HeldKey:
    """Tracks one held key. `releases`: the terminal reports them. Instants in ns on any clock."""

    def __init__(self, *, releases: bool) -> None:
        self.releases = releases
        self.key: str | None = None
        self.until_ns: int | None = None
        self._last = ""
        self._last_ns = 0
        self._repeats = False

    def handle_key(self, key: KeyEvent, now_ns: int) -> KeyChange | None:
        """Handle an event of a key that can be held."""
        return self._handle_reported(key, now_ns) if self.releases else self._handle_repeated(key.name, now_ns)

    def note_activity(self, now_ns: int) -> None:
        """Note an event of another key: the terminal is connected."""
        if self.releases and self.key is not None:
            self.until_ns = now_ns + SILENCE_NS

    def check_time(self, now_ns: int) -> KeyChange | None:
        """Return the change that follows from the time passed."""
        if self.until_ns is None or now_ns < self.until_ns:
            return None
        self.release_key()
        return KeyChange.SILENT if self.releases else KeyChange.END

    def release_key(self) -> None:
        """Treat the key as released, whatever events follow."""
        self.key = self.until_ns = None

    def _handle_reported(self, key: KeyEvent, now_ns: int) -> KeyChange | None:
        if key.kind == "press":
            self.key, self.until_ns = key.name, now_ns + SILENCE_NS
            return KeyChange.BEGIN
        self.note_activity(now_ns)
        if key.kind == "release" and key.name == self.key:
            self.release_key()
            return KeyChange.END
        return None

    def _handle_repeated(self, name: str, now_ns: int) -> KeyChange | None:
        silent_ns = now_ns - self._last_ns
        is_repeat = name == self._last and silent_ns <= (REPEAT_GAP_NS if self._repeats else REPEAT_DELAY_NS)
        is_held = self.key == name
        self.key = self._last = name
        self._last_ns = now_ns
        self._repeats = is_repeat
        if not is_repeat:
            self.until_ns = now_ns + TAP_NS
            return KeyChange.BEGIN
        self.until_ns = max(self.until_ns or 0, now_ns + REPEAT_WAIT_NS)
        return None if is_held else KeyChange.GO_ON
