"""What the jog panel does beside jogging: steps of a fixed length, enable, home, zero. One at a time, each a job of one
step that ends with the panel.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from orchestrator.clock.base import NS_PER_S

STEP_SIZES = (0.01, 0.1, 1.0, 10.0)  # in the axis's unit
CONFIRM_NS = 3 * NS_PER_S  # for the second press of a key that moves or shifts an axis by itself
MIN_SPEED = 0.001  # of a step: the slowest that a job can have


@dataclass(frozen=True, slots=True)
class RunWork:
    """Run a job of one step; then `handle_work_done`. words: what it does, e.g. `home gantry.x`."""

    words: str
    step: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class CancelWork:
    """Stop the job of the running work."""


class AxisWork:
    """The size of a step, the work that runs, and the key that waits for its second press."""

    def __init__(self) -> None:
        self.running: RunWork | None = None
        self._size = 0  # 0: jog while the key is held; else the number of a step size
        self._asked = ""
        self._asked_until_ns = 0

    @property
    def step_size(self) -> float | None:
        """The length of a step, in the axis's unit; None: arrows jog while they are held."""
        return None if self._size == 0 else STEP_SIZES[self._size - 1]

    def choose_next_size(self) -> None:
        """Go on to the next size, and after the largest to jogging."""
        self._size = (self._size + 1) % (len(STEP_SIZES) + 1)

    def start_step(self, axis: str, direction: int, speed: float) -> RunWork:
        """Start a step of the chosen size. speed: fraction of the axis's limit."""
        assert self.step_size is not None
        distance = direction * self.step_size
        step = {"do": "move", "by": {axis: distance}, "speed": min(1.0, max(MIN_SPEED, speed))}
        return self._start(RunWork(f"move {axis} by {distance:g}", step))

    def start_enabling(self, axis: str) -> RunWork:
        """Start switching the motor on."""
        return self._start(RunWork(f"enable {axis}", {"do": "enable", "axes": [axis]}))

    def start_homing(self, axis: str, now_ns: int) -> RunWork | None:
        """Start homing at the second press; None at the first one."""
        return self._start_confirmed(RunWork(f"home {axis}", {"do": "home", "axes": [axis]}), now_ns)

    def start_zeroing(self, axis: str, now_ns: int) -> RunWork | None:
        """Start setting the position to 0 at the second press; None at the first one."""
        return self._start_confirmed(RunWork(f"zero {axis}", {"do": "set-position", "axes": {axis: 0}}), now_ns)

    def forget_question(self) -> None:
        """Let a later press count as a first one."""
        self._asked = ""

    def _start_confirmed(self, work: RunWork, now_ns: int) -> RunWork | None:
        if self._asked == work.words and now_ns < self._asked_until_ns:
            return self._start(work)
        self._asked, self._asked_until_ns = work.words, now_ns + CONFIRM_NS
        return None

    def _start(self, work: RunWork) -> RunWork:
        self._asked, self.running = "", work
        return work
