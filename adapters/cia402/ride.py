"""One drive in a stream of positions: its set-point for each SYNC, and the check of its answers."""

from collections.abc import Callable

from adapters.cia402 import states
from adapters.cia402.course import SetpointTrajectory
from adapters.cia402.node import BusDrive, SyncAnswer
from adapters.cia402.switching import EdgeLog, OutputSchedule
from orchestrator.link.can import CanFrame


class StreamedMove:
    """The motion of a drive along its set-point trajectory, with the outputs that are switched on the way. failed:
    called once, when the motion cannot continue; the reason is `failure`."""

    def __init__(
        self, node: BusDrive, trajectory: SetpointTrajectory, switched: OutputSchedule, failed: Callable[[], None]
    ) -> None:
        self._node = node
        self._switched = switched
        self.edges = EdgeLog(switched)
        self._outputs = self._outputs_before = node.outputs
        self._outputs_from = 0
        self._from = 0
        self._later = self._earlier = trajectory.setpoint_function()
        self._sent = -1
        self._failed = failed
        self._written_ns = 0
        self._set_count(trajectory)
        self.failure = ""
        self.has_arrived = False
        self.last_written_ns = 0
        """When the SYNC of its end position was written."""
        self.last_answer_ns = 0
        """When its answer to that SYNC arrived; 0: it was not checked in time."""

    def _set_count(self, trajectory: SetpointTrajectory) -> None:
        self._end_number = trajectory.point_count - 1
        # At the end it stands until the last output is passive.
        self.position_count = max(trajectory.point_count, self._switched.last)

    @property
    def is_done(self) -> bool:
        """Whether it has arrived, or failed."""
        return self.has_arrived or bool(self.failure)

    def _setpoint_at(self, number: int) -> int:
        return (self._later if number >= self._from else self._earlier)(number)

    @property
    def next_number(self) -> int:
        """The first position that is not sent yet."""
        return self._sent + 1

    def continue_with(self, trajectory: SetpointTrajectory, number: int) -> None:
        """Take the positions from `number` on from another trajectory; none of them is sent yet."""
        self._earlier, self._later, self._from = self._later, trajectory.setpoint_function(), number
        self._set_count(trajectory)

    def change_outputs(self, outputs: int) -> int:
        """Switch other outputs with the next position that is not sent yet, and return its number."""
        self._outputs_before, self._outputs, self._outputs_from = self._outputs, outputs, self.next_number
        return self.next_number

    def position_frame(self, number: int) -> CanFrame:
        self._sent = max(self._sent, number)
        others = self._outputs if number >= self._outputs_from else self._outputs_before
        return self._node.position_frame(self._setpoint_at(number), self._switched.outputs_at(others, number))

    @property
    def passive_frame(self) -> CanFrame | None:
        return self._node.position_frame(self._node.given) if self._node.switches_with_positions else None

    def record_write(self, number: int, at_ns: int) -> None:
        self._written_ns = at_ns
        self._node.given = self._setpoint_at(number)
        self.edges.record_write(number, at_ns)
        if number == self._end_number:
            self.last_written_ns = at_ns

    def check_answer(self, number: int) -> None:
        """Check its answer to a SYNC, which contains its demanded position: at that time, the position of the previous
        SYNC."""
        node, answer = self._node, self._node.answer
        if self.is_done or not node.is_enabled:
            return  # its state shows what has happened
        if answer.at_ns <= self._written_ns:
            self.fail_stream(f"has not answered SYNC {number} of its stream (underrun)")
        elif not answer.status & states.FOLLOWS:
            self.fail_stream("does not follow the positions of its stream: bit 12 of its statusword is off")
        elif abs(answer.demand - self._setpoint_at(number - 2)) < abs(answer.demand - self._setpoint_at(number - 1)):
            self.fail_stream(f"had no position with SYNC {number - 1} of its stream (underrun)")
        else:
            self._take_answer(number, answer)

    def _take_answer(self, number: int, answer: SyncAnswer) -> None:
        self.edges.record_answer(number, answer.at_ns)
        if number == self._end_number:
            self.last_answer_ns = answer.at_ns
        elif number > self.position_count and answer.demand == self._setpoint_at(number):
            self.has_arrived = True
            self._node.demand = answer.demand  # its unsolicited message may come later
            self._node.wake_waiting()

    def fail_stream(self, text: str) -> None:
        if not self.is_done:
            self.failure = text
            self._failed()
            self._node.wake_waiting()

    def end_stream(self) -> None:
        self.fail_stream("has not reached the end of its stream")
