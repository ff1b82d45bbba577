"""The truth about motion, written down for those who test: no client of the wire can see it."""

import json
from typing import TextIO

from orchestrator.clock.base import NS_PER_MS, Clock
from sim.core.controller import Motion, SimulatedController

LOOK_EVERY_NS = 100 * NS_PER_MS  # a look takes a tenth of a millisecond from what is tested


class TruthLog:
    """Writes a JSON line to `file` for every motion when it has started, when it slows down because of a stop, and when
    it has ended.

    Instants are host time (`CLOCK_MONOTONIC_RAW`), ns, as the simulator made them; they are written down later.
    """

    def __init__(self, controller: SimulatedController, clock: Clock, file: TextIO) -> None:
        self._controller = controller
        self._clock = clock
        self._file = file
        self._seen = 0
        self._running: list[Motion] = []
        self._slowing: list[Motion] = []
        self._look()

    def _look(self) -> None:
        motions, now_ns = self._controller.motions, self._clock.now_ns()
        while self._seen < len(motions) and motions[self._seen].start_ns <= now_ns:
            self._running.append(motions[self._seen])
            self._write("start", motions[self._seen])
            self._seen += 1
        for motion in [each for each in self._running if _past(each.slowing_ns, now_ns)]:
            self._running.remove(motion)
            self._slowing.append(motion)
            self._write("slowing", motion)
        for motion in [each for each in (*self._running, *self._slowing) if _past(each.end_ns, now_ns)]:
            (self._slowing if motion in self._slowing else self._running).remove(motion)
            self._write("end", motion)
        self._clock.call_at_ns(now_ns + LOOK_EVERY_NS, self._look)

    def _write(self, event: str, motion: Motion) -> None:
        entry: dict[str, object] = {
            "event": event,
            "axis": motion.axis,
            "start_ns": motion.start_ns,
            "start_counts": motion.start_counts,
        }
        if event == "slowing":
            entry |= {"slowing_ns": motion.slowing_ns}
        elif event == "end":
            entry |= {"end_ns": motion.end_ns, "end_counts": motion.end_counts}
        self._file.write(json.dumps(entry) + "\n")
        self._file.flush()


def _past(at_ns: int | None, now_ns: int) -> bool:
    return at_ns is not None and at_ns <= now_ns
