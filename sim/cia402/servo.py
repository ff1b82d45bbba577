"""The motor under the control loop: user's units, limits, following error, and when a target is reached."""

import math
from collections.abc import Callable

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from sim.cia402.dictionary import Dictionary
from sim.cia402.mover import Mark, Mover
from sim.cia402.options import Options
from sim.cia402.profile import Plan, to_rest
from sim.cia402.terminals import Terminals
from sim.core.devicetime import DeviceTime

AXIS = "1"
UNLIMITED = 0xFFFF_FFFF
"""Of a following error window, and of other objects that can be switched off."""


class Servo:
    """changed: something that a client can see has changed. ended: a motion has come to rest. limit: the motor runs
    into a limit switch (-1 negative, 1 positive). strayed: the following error has been too large for too long.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        time: DeviceTime,
        options: Options,
        phase_ns: int,
        changed: Callable[[], None],
        ended: Callable[[], None],
        limit: Callable[[int], None],
        strayed: Callable[[], None],
    ) -> None:
        self._dictionary = dictionary
        self._options = options
        self._phase_ns = phase_ns
        self._changed = changed
        self._ended = ended
        self._limit = limit
        self._strayed = strayed
        self._stuck_at: float | None = None
        self._pending = 0
        self._orders = 0
        self._rested_ns = 0
        self.time = time
        self.offset = 0.0
        """From mechanical to the user's positions; homing sets it."""
        self.internal_limit = False
        """Bit 11 of the statusword."""
        self.wanted: list[Mark] = []
        """What a homing looks for."""
        self.terminals = Terminals(options, changed)
        self.mover = Mover(time, AXIS, self._marks, self._rested)
        self.mover.shift = lambda: self.offset

    # Values, in the user's units

    @property
    def demand(self) -> float:
        return self.mover.position + self.offset

    @property
    def mechanical(self) -> float:
        """Where the motor really is."""
        return self.mover.position if self._stuck_at is None else self._stuck_at

    @property
    def actual(self) -> float:
        return self.mechanical + self.offset

    @property
    def speed(self) -> float:
        """Commanded, per second of the drive's crystal."""
        return self.mover.speed

    @property
    def busy(self) -> bool:
        """It moves, or will with one of the next ticks."""
        return self.mover.moving or self._pending > 0

    @property
    def stuck(self) -> bool:
        return self._stuck_at is not None

    def velocity(self, index: int, sub: int = 0) -> float:
        """An object in velocity units, as units per second."""
        return self._scaled(index, sub, 0x6096)

    def acceleration(self, index: int) -> float:
        """An object in acceleration units, as units per second squared."""
        return self._scaled(index, 0, 0x6097)

    def velocity_units(self, speed: float) -> int:
        return round(speed * self._dictionary.get(0x6096, 2) / self._dictionary.get(0x6096, 1))

    def _scaled(self, index: int, sub: int, factor: int) -> float:
        get = self._dictionary.get
        return get(index, sub) * get(factor, 1) / get(factor, 2)

    def clipped(self, target: float) -> float:
        """The nearest position within the software limits (0x607D; none when the lower is not below the upper)."""
        low, high = self._dictionary.get(0x607D, 1), self._dictionary.get(0x607D, 2)
        if low >= high:
            return target
        return min(max(target, low), high)

    # Orders

    def at_tick(self, action: Callable[[], None]) -> None:
        """Do it in the next tick of the control loop, unless something else is ordered before."""
        cycle_ns = self._options.cycle_us * NS_PER_US
        now_ns = self.time.now_ns()
        at_ns = now_ns + (self._phase_ns - now_ns) % cycle_ns
        self._orders += 1
        self._pending = order = self._orders

        def act() -> None:
            if self._pending == order:
                self._pending = 0
                action()
                self._changed()

        if at_ns == now_ns:
            act()
        else:
            self.time.call_at(at_ns, act)

    def forget(self) -> None:
        """What was to begin with the next tick does not."""
        self._pending = 0

    def go(self, plan: Plan, slowing: bool = False) -> None:
        """Follow `plan` from now on, unless a pressed limit switch forbids it."""
        way = plan.distance if plan.distance else plan.segments[0].v
        negative, positive = self.terminals.limits(self.mechanical)
        if not slowing and ((way < 0 and negative) or (way > 0 and positive)):
            self._limit(-1 if way < 0 else 1)
            return
        if not slowing:
            self.internal_limit = False
        self.mover.go(plan, slowing)
        self._changed()

    def slow_down(self, rate: float) -> None:
        """Come to rest, from the next tick on."""

        def act() -> None:
            if self.mover.moving:
                self.go(to_rest(self.speed, rate), slowing=True)

        self.at_tick(act)

    def let_go(self) -> None:
        """The power stage is off: the motor stands still, and the demand is where it stands."""
        if self.busy:
            self._rested_ns = self.time.now_ns()
            self.time.call_after(self._settle_ns(), self._changed)
        self.forget()
        self.mover.interpolate(False)
        self.mover.halt_dead()
        self.mover.put(self.mechanical)

    def _rested(self) -> None:
        self._rested_ns = self.time.now_ns()
        self.time.call_after(self._settle_ns(), self._changed)
        self._ended()
        self._changed()

    # Target reached

    def _settle_ns(self) -> int:
        return self._options.settle_us * NS_PER_US + self._dictionary.get(0x6068) * NS_PER_MS

    def settled(self) -> bool:
        """At rest, in the position window, for long enough."""
        if self.busy or self.time.now_ns() < self._rested_ns + self._settle_ns():
            return False
        return abs(self.demand - self.actual) <= self._dictionary.get(0x6067)

    # The physical world

    def set_stalled(self, stalled: bool) -> None:
        self._stuck_at = self.mechanical if stalled else None
        self.mover.look_again()
        self._changed()

    def push(self, distance: float) -> None:
        if self._stuck_at is not None:
            self._stuck_at += distance
        self.mover.put(self.mover.position + distance)
        self._changed()

    def _marks(self) -> list[Mark]:
        marks = self.terminals.marks(self._limit) + self.wanted
        window = self._dictionary.get(0x6065)
        if self._stuck_at is not None and window != UNLIMITED:
            marks += [Mark(self._stuck_at + sign * window, sign, self._astray) for sign in (-1, 1)]
        return marks

    def _astray(self) -> None:
        def due() -> None:
            # In whole units, as 0x60F4 says it: at the edge of the window they are as many as it is wide.
            if self._stuck_at is not None and round(abs(self.demand - self.actual)) >= self._dictionary.get(0x6065):
                self._strayed()

        self.time.call_after(self._dictionary.get(0x6066) * NS_PER_MS, due)

    def period_s(self) -> float:
        """The interpolation time period, 0x60C2."""
        return self._dictionary.get(0x60C2, 1) * 10.0 ** self._dictionary.get(0x60C2, 2)

    def period_ns(self) -> int:
        return math.ceil(self.period_s() * NS_PER_S)
