"""Pauses between attempts to reach a controller: short after a short outage, longer the longer it lasts."""

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock

FIRST_NS = 200 * NS_PER_MS
LONGEST_NS = 5 * NS_PER_S
SHARE = 8
"""A pause is at most this part of the time since the controller was last reached: a link that was away for three
seconds is not waited for another three, and one that is away for a night is tried every five seconds."""


class AttemptPauses:
    """The pauses of one controller. pause_ns: after the present attempt; 0: its connection was lost, and is tried at
    once where a stop is pending."""

    def __init__(self, clock: Clock) -> None:
        self.pause_ns = FIRST_NS
        self._clock = clock
        self._reached_ns = clock.now_ns()

    def note_lost(self) -> None:
        """The controller was reached until now."""
        self.pause_ns, self._reached_ns = 0, self._clock.now_ns()

    def prolong_pause(self, *, is_defect: bool) -> None:
        """Another attempt follows. is_defect: the adapter itself has failed, which does not pass with an outage."""
        share_ns = LONGEST_NS if is_defect else (self._clock.now_ns() - self._reached_ns) // SHARE
        self.pause_ns = max(FIRST_NS, min(2 * self.pause_ns, share_ns, LONGEST_NS))
