"""The slots of starting commands on a line: without other traffic, so that a reply in a slot is the answer to its
command."""

import asyncio
from dataclasses import dataclass, field

from adapters.smc30.frames import ReceivedReply
from orchestrator.clock.base import Clock
from orchestrator.model.errors import Refusal


@dataclass(slots=True)
class StartSlot:
    """A slot for one command that is written at `begin_ns`, takes `wire_ns`, and is answered within `each_ns` after
    that.

    late_ns: the largest delay beyond the guarantee; once the command was written, its real delay.
    answer: its answer; None: none has arrived, or it cannot be assigned.
    """

    unit: int | None
    begin_ns: int
    wire_ns: int
    each_ns: int
    late_ns: int = 0
    answer: "asyncio.Future[ReceivedReply | None]" = field(
        default_factory=lambda: asyncio.get_running_loop().create_future(), repr=False
    )

    @property
    def end_ns(self) -> int:
        """The end of the slot for other traffic: a late host gets one more slot."""
        return self.begin_ns + self.wire_ns + 2 * self.each_ns + self.late_ns

    def set_answer(self, reply: ReceivedReply | None) -> None:
        if not self.answer.done():
            self.answer.set_result(reply)


class StartSlots:
    """The slots of one line that are reserved and not over."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._slots: list[StartSlot] = []
        self._answers: list[ReceivedReply] = []

    def reserve_slot(self, slot: StartSlot) -> None:
        """Reserve a slot. Raises `Refusal` when another one overlaps it."""
        for other_slot in self._slots:
            if abs(slot.begin_ns - other_slot.begin_ns) < max(slot.each_ns, other_slot.each_ns):
                raise Refusal(
                    "line-busy",
                    f"{controller_name(slot.unit)}: the line starts {controller_name(other_slot.unit)} at that instant",
                    "start controllers of one line in one step, or at least a second apart",
                )
        self._slots.append(slot)
        self._clock.call_at_ns(slot.end_ns, self._assign_answers)

    def record_write(self, slot: StartSlot, late_ns: int) -> None:
        """Record that its command was written, with this delay beyond the guarantee: the slot is shortened to that."""
        slot.late_ns = late_ns
        self._clock.call_at_ns(slot.end_ns, self._assign_answers)

    def free_slot(self, slot: StartSlot) -> None:
        """Free a slot whose command was not and will not be written."""
        slot.set_answer(None)
        if slot in self._slots:
            self._slots.remove(slot)

    def take_answer(self, reply: ReceivedReply) -> bool:
        """Take a reply that arrived in a slot; return whether it did."""
        if not any(shot.begin_ns + shot.wire_ns <= reply.at_ns <= shot.end_ns for shot in self._slots):
            return False
        self._answers.append(reply)
        return True

    def find_gap_ns(self, usual_ns: int, since_ns: int) -> int:
        """Return from when on, not before `since_ns`, an exchange of that duration has room before the next slot."""
        now_ns, until_ns = self._clock.now_ns(), since_ns
        for shot in self._slots:
            if shot.begin_ns - usual_ns <= now_ns < shot.end_ns:
                until_ns = max(until_ns, shot.end_ns)
        return until_ns

    def free_all(self) -> None:
        """Free all slots: the link is lost."""
        for shot in self._slots:
            shot.set_answer(None)
        self._slots.clear()
        self._answers.clear()

    def _assign_answers(self) -> None:
        """Assign the answers of adjacent slots in the order of the slots, because the delay of a late host makes their
        instants ambiguous. If an answer is missing, none of them can be assigned."""
        now_ns = self._clock.now_ns()
        started_slots = sorted(
            (shot for shot in self._slots if shot.begin_ns <= now_ns), key=lambda shot: shot.begin_ns
        )
        if any(shot.end_ns > now_ns for shot in started_slots):
            return
        answers, self._answers = self._answers, []
        sure = len(answers) == len(started_slots)
        for number, shot in enumerate(started_slots):
            shot.set_answer(answers[number] if sure else None)
            self._slots.remove(shot)


def controller_name(unit: int | None) -> str:
    """Return how messages call a controller of the line."""
    return "the controller" if unit is None else f"unit {unit}"
