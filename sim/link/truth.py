"""Log of the ground truth of motion, for tests; not visible to clients."""

import json
from typing import TextIO

from orchestrator.clock.base import NS_PER_MS, Clock
from sim.core.controller import CommandedMotion, SimulatedController

POLL_PERIOD_NS = 100 * NS_PER_MS  # one poll takes a tenth of a millisecond from the system under test


class GroundTruthLog:
    """Write a JSON line to `file` for every motion when it starts, when it slows down because of a stop, and when it
    ends.

    Instants are host time (`CLOCK_MONOTONIC_RAW`), ns, as the simulator made them; they are written later.
    """

    def __init__(self, controller: SimulatedController, clock: Clock, file: TextIO) -> None:
        self._controller = controller
        self._clock = clock
        self._file = file
        self._polled_count = 0
        self._running: list[CommandedMotion] = []
        self._slowing: list[CommandedMotion] = []
        self._poll_motions()

    def _poll_motions(self) -> None:
        motions, now_ns = self._controller.commanded_motions, self._clock.now_ns()
        while self._polled_count < len(motions) and motions[self._polled_count].start_ns <= now_ns:
            self._running.append(motions[self._polled_count])
            self._write_event("start", motions[self._polled_count])
            self._polled_count += 1
        for motion in [motion for motion in self._running if _has_passed(motion.slowing_ns, now_ns)]:
            self._running.remove(motion)
            self._slowing.append(motion)
            self._write_event("slowing", motion)
        for motion in [slowing for slowing in (*self._running, *self._slowing) if _has_passed(slowing.end_ns, now_ns)]:
            (self._slowing if motion in self._slowing else self._running).remove(motion)
            self._write_event("end", motion)
        self._clock.call_at_ns(now_ns + POLL_PERIOD_NS, self._poll_motions)

    def _write_event(self, event: str, motion: CommandedMotion) -> None:
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


def _has_passed(at_ns: int | None, now_ns: int) -> bool:
    return at_ns is not None and at_ns <= now_ns
