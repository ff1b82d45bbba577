"""One drive in a stream of positions: what it is told with each SYNC, and whether it follows, by its own answers."""

from collections.abc import Callable

from adapters.cia402 import states
from adapters.cia402.course import Course
from adapters.cia402.node import Node
from orchestrator.link.can import CanFrame


class Ride:
    """The way of a drive along its course. failed: called once, when it can not go on; the reason is `trouble`."""

    def __init__(self, node: Node, course: Course, failed: Callable[[], None]) -> None:
        self._node = node
        self._point = course.points()
        self._failed = failed
        self._written_ns = 0
        self.count = course.count
        self.trouble = ""
        self.arrived = False
        self.last_written_ns = 0
        """When the SYNC was handed over that has it go to its end."""
        self.last_heard_ns = 0
        """When its answer to that came; 0: it was not looked for in time."""

    @property
    def done(self) -> bool:
        """Arrived, or failed."""
        return self.arrived or bool(self.trouble)

    def frame(self, number: int) -> CanFrame:
        return self._node.position(self._point(number))

    def written(self, number: int, at_ns: int) -> None:
        self._written_ns = at_ns
        if number == self.count - 1:
            self.last_written_ns = at_ns

    def judge(self, number: int) -> None:
        """With each SYNC it says where it has come to: by then, to the position of the SYNC before."""
        node, answer = self._node, self._node.answer
        if self.done or not node.enabled:
            return  # what has befallen it is told by its state
        if answer.at_ns <= self._written_ns:
            self.fail(f"has not answered SYNC {number} of its stream (underrun)")
        elif not answer.status & states.FOLLOWS:
            self.fail("does not follow the positions of its stream: bit 12 of its statusword is off")
        elif abs(answer.demand - self._point(number - 2)) < abs(answer.demand - self._point(number - 1)):
            self.fail(f"had no position with SYNC {number - 1} of its stream (underrun)")
        elif number == self.count - 1:
            self.last_heard_ns = answer.at_ns
        elif number > self.count and answer.demand == self._point(number):
            self.arrived = True
            node.demand = answer.demand  # what it says by itself may come later
            node.wake()

    def fail(self, text: str) -> None:
        if not self.done:
            self.trouble = text
            self._failed()
            self._node.wake()

    def over(self) -> None:
        self.fail("has not come to the end of its stream")
