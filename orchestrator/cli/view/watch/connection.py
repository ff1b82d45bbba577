"""Whether the fleet is still received: adapters publish their states several times a second."""

from collections.abc import Callable

SILENCE_S = 1.5  # adapters publish at least every 0.4 s


class ConnectionWatch:
    """Notes what is received, and says when that ends and when it goes on. now_s: a monotonic clock."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._received_s = now_s()
        self.is_connected = True

    @property
    def silence_s(self) -> float:
        """Since when nothing has been received, in s."""
        return self._now_s() - self._received_s

    def note_sample(self) -> str | None:
        """Something was received. Return the line to show if it is the first after a silence."""
        silence_s, was_connected = self.silence_s, self.is_connected
        self._received_s, self.is_connected = self._now_s(), True
        return None if was_connected else f"connected again after {silence_s:.0f} s"

    def check_silence(self) -> str | None:
        """Return the line to show if the connection is lost since the last call."""
        if not self.is_connected or self.silence_s <= SILENCE_S:
            return None
        self.is_connected = False
        return f"disconnected: nothing received for {self.silence_s:.1f} s; the states shown are old"
