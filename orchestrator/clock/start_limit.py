"""How long the start of a process may take: what earlier starts on its computer needed decides, within bounds."""

from orchestrator.clock.base import NS_PER_S

SLOW_NS = 10 * NS_PER_S  # a start that needs longer is said: an idle computer needs one or two seconds
_SHARE = 3  # of what the last start needed; a computer that is busy now and then varies by as much
_GROWTH = 2  # after a start that was ended because it took too long


class StartLimit:
    """The limit of the next start, in ns: at least `least_ns`, at most `longest_ns`."""

    def __init__(self, least_ns: int, longest_ns: int) -> None:
        self._least_ns = least_ns
        self._longest_ns = longest_ns
        self.limit_ns = least_ns

    def note_start(self, needed_ns: int) -> None:
        """A start was completed; it has needed `needed_ns`."""
        self._set(_SHARE * needed_ns)

    def note_end(self) -> None:
        """A start has reached its limit, and was ended: the next one has more time."""
        self._set(_GROWTH * self.limit_ns)

    def _set(self, limit_ns: int) -> None:
        self.limit_ns = min(max(limit_ns, self._least_ns), self._longest_ns)
