"""A physical contact: an input changes where an axis is, by its truth. For probes; not visible to clients."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, Clock, ClockTimer
from sim.core.controller import SimulatedController

LONGEST_LOOK_NS = NS_PER_MS
SHORTEST_LOOK_NS = 20 * NS_PER_US


@dataclass(frozen=True, slots=True)
class ContactPlace:
    """Where a contact is made. axis: the make's name. at_counts: physical position of the axis; side: 1 where it is
    made at this position and above, -1 below. number, level: the input, and its level while the contact is made.
    bounces_ns: when it is made, how long it is closed, open, closed, …; an odd number of them leaves it open. beside:
    further axes, of which it is kept where they are then.
    """

    axis: str
    at_counts: float
    side: int
    number: int
    level: bool
    bounces_ns: Sequence[int] = ()
    beside: Sequence[str] = ()


@dataclass(slots=True)
class MadeContact:
    """When a contact was made, true time, and where the axis was. beside: where further axes were."""

    at_ns: int
    counts: float
    beside: Mapping[str, float]


class PhysicalContact:
    """Watches the truth of one axis, and switches an input.

    It looks as often as the axis can come nearer in: at most every 20 µs, and every millisecond far away or at rest. An
    axis at 10 mm/s is 0.2 µm farther at most when it is seen.
    """

    def __init__(self, controller: SimulatedController, clock: Clock, place: ContactPlace) -> None:
        self._controller = controller
        self._clock = clock
        self._place = place
        self._timer: ClockTimer | None = None
        self._is_made = False
        self._changes: list[ClockTimer] = []
        self.made: list[MadeContact] = []
        self._switch(on=False)
        self._look()

    def remove(self) -> None:
        """Remove it: the input stays as it is."""
        for timer in (self._timer, *self._changes):
            if timer is not None:
                timer.cancel()
        self._timer = None

    def _look(self) -> None:
        contact = self._place
        counts = self._controller.physical_position(contact.axis)
        distance = contact.side * (contact.at_counts - counts)
        if (distance <= 0) != self._is_made:
            self._change(made=distance <= 0, counts=counts)
        self._timer = self._clock.call_at_ns(self._clock.now_ns() + self._find_pause_ns(distance), self._look)

    def _find_pause_ns(self, distance: float) -> int:
        speed = abs(self._controller.velocity(self._place.axis))
        if not speed:
            return LONGEST_LOOK_NS
        nearest_ns = round(abs(distance) / speed * NS_PER_S / 2)
        return min(LONGEST_LOOK_NS, max(SHORTEST_LOOK_NS, nearest_ns))

    def _change(self, *, made: bool, counts: float) -> None:
        self._is_made = made
        for timer in self._changes:
            timer.cancel()
        self._changes.clear()
        self._switch(on=made)
        if not made:
            return
        at_ns = self._clock.now_ns()
        positions_beside = {axis: self._controller.physical_position(axis) for axis in self._place.beside}
        self.made.append(MadeContact(at_ns, counts, positions_beside))
        for number, bounce_ns in enumerate(self._place.bounces_ns):
            at_ns += bounce_ns
            self._changes.append(self._clock.call_at_ns(at_ns, self._make_switch(on=number % 2 == 1)))

    def _make_switch(self, *, on: bool) -> Callable[[], None]:
        return lambda: self._switch(on=on)

    def _switch(self, *, on: bool) -> None:
        self._controller.set_input(self._place.number, level=on == self._place.level)


class ContactBench:
    """The contacts of simulated controllers of one process, one for each input."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._contacts: dict[tuple[int, int], PhysicalContact] = {}

    def put(self, controller: SimulatedController, place: ContactPlace) -> None:
        """Put a contact, in the place of another one of that input."""
        self.remove(controller, place.number)
        self._contacts[id(controller), place.number] = PhysicalContact(controller, self._clock, place)

    def remove(self, controller: SimulatedController, number: int) -> None:
        """Remove the contact of an input, if it has one; the input stays as it is."""
        contact = self._contacts.pop((id(controller), number), None)
        if contact is not None:
            contact.remove()
