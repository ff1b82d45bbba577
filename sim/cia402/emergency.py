"""EMCY: error messages of the node, and the history of its errors (CiA 301)."""

from collections import deque
from collections.abc import Callable

from orchestrator.clock.base import NS_PER_US
from orchestrator.link.can import CanFrame
from sim.cia402 import aborts
from sim.cia402.aborts import SdoAbort
from sim.cia402.dictionary import DriveDictionary
from sim.cia402.timers import NodeTimers

_NO_CLIENT = 0x8000_0000
_ID = 0x7FF
_HISTORY = 8


class EmergencyProducer:
    """Sends EMCYs. `may_send`: whether the node's state allows it."""

    def __init__(
        self,
        dictionary: DriveDictionary,
        timers: NodeTimers,
        send_frame: Callable[[CanFrame], None],
        may_send: Callable[[], bool],
    ) -> None:
        self._dictionary = dictionary
        self._timers = timers
        self._send_frame = send_frame
        self._may_send = may_send
        self._queue: deque[bytes] = deque()

    def clear_queue(self) -> None:
        """Discard the EMCYs that wait for the inhibit time."""
        self._queue.clear()

    def send_emergency(self, code: int, register: int) -> None:
        """Send EMCY, and add the error to the history. Code 0: no error is left."""
        dictionary = self._dictionary
        dictionary.put_value(0x1001, 0, register)
        if code:
            errors = [dictionary.get_value(0x1003, sub) for sub in range(1, _HISTORY)]
            for sub, error in enumerate([code, *errors], 1):
                dictionary.put_value(0x1003, sub, error)
            dictionary.put_value(0x1003, 0, min(_HISTORY, dictionary.get_value(0x1003, 0) + 1))
        if self._may_send() and not dictionary.get_value(0x1014) & _NO_CLIENT:
            self._queue.append(code.to_bytes(2, "little") + bytes([register, 0, 0, 0, 0, 0]))
            if not self._timers.is_set("emergency"):
                self._send_next_emergency()

    def _send_next_emergency(self) -> None:
        """Send the queued EMCYs one at a time, each after the inhibit time of the one before (0x1015, in 100 µs)."""
        self._timers.cancel_timer("emergency")
        if not self._queue:
            return
        self._send_frame(CanFrame(self._dictionary.get_value(0x1014) & _ID, self._queue.popleft()))
        inhibit_ns = self._dictionary.get_value(0x1015) * 100 * NS_PER_US
        if inhibit_ns:
            self._timers.call_later("emergency", inhibit_ns, self._send_next_emergency)
        elif self._queue:
            self._send_next_emergency()

    def clear_history(self, value: int) -> None:
        """Handle a write to 0x1003: 0 clears the history."""
        if value:
            raise SdoAbort(aborts.RANGE)
        for sub in range(1, _HISTORY + 1):
            self._dictionary.put_value(0x1003, sub, 0)
