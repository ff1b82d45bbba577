"""What the driver knows of the unit between two commands, and its looks at it."""

import asyncio
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction

from adapters.contract import CannotDo, DriverFault
from adapters.ppsmc import fleetaxes
from adapters.ppsmc.replies import ASK_ERRORS, ASK_POSITIONS, ASK_STATUS, Bits, entries, errors, number_in, states
from adapters.ppsmc.session import Line, Session
from adapters.ppsmc.stopper import Stopper
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import Controller


@dataclass(frozen=True, slots=True)
class Look:
    """One look at all axes of the unit, by number. counts: None while an axis oscillates; to within
    `grains` steps, by the decimals that were told. at_ns: when the answer had
    come. begun_ns: when it was asked."""

    bits: Mapping[int, int]
    counts: Mapping[int, int | None]
    grains: Mapping[int, float]
    begun_ns: int
    at_ns: int

    @property
    def idle(self) -> bool:
        """Whether nothing moves and no program runs."""
        return all(bits & Bits.IDLE and not bits & Bits.PROGRAM for bits in self.bits.values())

    @property
    def program(self) -> bool:
        return any(bits & Bits.PROGRAM for bits in self.bits.values())

    @property
    def blocked(self) -> bool:
        return any(bits & Bits.BLOCKED for bits in self.bits.values())

    @property
    def on_limit(self) -> bool:
        return any(bits & (Bits.LIMIT_FORWARD | Bits.LIMIT_REVERSE) for bits in self.bits.values())

    def ready(self, motor: int) -> bool:
        return bool(self.bits[motor] & Bits.READY)


@dataclass(slots=True)
class UnitState:
    """One connection to one unit.

    gears: steps per mm or deg, and homes: position after a reference search, by axis number. closed: axes in closed
    loop. enabled: by name, what the adapter may move. referenced: axes that have been seen with an installed reference
    since the last search. spoiled: axes that a limit switch has stopped, whose position is not valid (L2546).
    loading: held by whoever configures the unit, output_turn: by whoever changes outputs. untidy: a stop or a move may
    have left targets. profiles: what is known to be loaded. introduced: compared with the fleet file. driving: a step
    switches an output. watched: told of every look while a move is under way.
    """

    session: Session
    stopper: Stopper
    config: Controller
    slow_ns: int
    gears: dict[int, Fraction] = field(default_factory=dict[int, Fraction])
    homes: dict[int, int] = field(default_factory=dict[int, int])
    closed: set[int] = field(default_factory=set[int])
    enabled: set[str] = field(default_factory=set[str])
    referenced: set[int] = field(default_factory=set[int])
    spoiled: set[int] = field(default_factory=set[int])
    loading: asyncio.Lock = field(default_factory=asyncio.Lock)
    by_hand: set[int] = field(default_factory=set[int])
    profiles: dict[int, tuple[int, int, int, int]] = field(default_factory=dict[int, tuple[int, int, int, int]])
    output_turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    untidy: bool = False
    introduced: bool = False
    driving: bool = False
    watched: Callable[[Look], None] | None = None
    installed: int = 0
    _stops_given: Counter[int] = field(default_factory=Counter[int])

    # Looking

    async def look(self) -> Look:
        """Status and positions of all axes, of a blocked unit as well. Raises `DriverFault`."""
        session = self.session
        if not session.blocked:
            try:
                heard = await session.ask(ASK_STATUS, ASK_POSITIONS)
            except DriverFault as error:
                if error.fault.code != "blocked":
                    raise
            else:
                return self.looked(heard.one(ASK_STATUS), heard.one(ASK_POSITIONS), heard.written_ns)
        status, positions = await session.ask_blocked()
        return self.looked(status, positions, status.at_ns)

    def looked(self, status: Line, positions: Line, begun_ns: int) -> Look:
        """What two answers say. Raises `DriverFault` when an axis is missing in them."""
        bits = states(status.text)
        counts: dict[int, int | None] = {}
        grains: dict[int, float] = {}
        for number, text in entries(positions.text).items():
            distance = number_in(text)
            gear = self.gears.get(number, Fraction(1))
            counts[number] = None if distance is None else fleetaxes.steps(distance, gear)
            grains[number] = 1.0 if distance is None else fleetaxes.grain(distance, gear)
        for motor in fleetaxes.motors(self.config).values():
            if motor not in bits or motor not in counts:
                raise DriverFault(
                    "garbage",
                    f"axis {motor} is missing in the answers {status.text!r} and {positions.text!r}",
                    "check cable and ground, and `motors` in the fleet file",
                )
        self.installed = max(bits)
        look = Look(bits, counts, grains, begun_ns, positions.at_ns)
        if self.watched is not None:
            self.watched(look)
        return look

    async def errors(self) -> dict[int, tuple[int, str]]:
        """Number and text of the last error, by axis."""
        heard = await self.session.ask(ASK_ERRORS)
        return errors(heard.lines(ASK_ERRORS))

    # Setting going, and stopping

    def count_stop(self, motors: Iterable[int]) -> None:
        """A stop is written for these motors: what waits for its turn must not set them going after it."""
        self._stops_given.update(motors)

    def stops_given(self, motor: int) -> int:
        """A number that every stop of this motor raises."""
        return self._stops_given[motor]

    def require_no_stop(self, axis: str, motor: int, since: int) -> None:
        """Raises `CannotDo` when a stop has come since `stops_given` was `since`."""
        if self._stops_given[motor] != since:
            raise CannotDo("stopped", f"axis {axis} was stopped meanwhile", "")

    async def set_going(self, command: str, axis: str, motor: int, since: int) -> None:
        """Send a line that moves one motor, unless a stop has come since `stops_given` was `since`, or the unit has
        begun anew: its position and its speeds are others then. Raises `CannotDo`; then nothing was sent."""
        sent = False

        def still() -> None:
            nonlocal sent
            self.require_no_stop(axis, motor, since)
            if self.session.restarted:
                raise CannotDo("not-started", f"the unit was restarted before axis {axis} began", "home it first")
            sent = True

        try:
            await self.session.say((command,), still=still)
        except BaseException:
            # Cancelled, or without an answer: nobody would stop it any more.
            if sent:
                with suppress(LinkClosed):
                    self.brake([motor])
            raise

    def brake(self, motors: Iterable[int]) -> int:
        """`q` to each, past everything else."""
        return self.write_stop(*(f"q{motor}" for motor in motors))

    def write_stop(self, *lines: str) -> int:
        """Write on both connections: on the stop's own, because nothing is before it there; on the first, because
        what was written there before must not be executed after the stop. Gives the instant. Raises `LinkClosed`."""
        alone_ns = self.stopper.write(*lines)
        try:
            at_ns = self.session.interrupt(*lines)
        except LinkClosed:
            if alone_ns is None:
                raise
            return alone_ns
        return at_ns if alone_ns is None else alone_ns

    def require_enabled(self, names: Iterable[str]) -> None:
        """Raises `CannotDo` for an axis that is switched off here; the unit itself has no such switch."""
        for name in names:
            if name not in self.enabled:
                raise CannotDo("not-enabled", f"axis {name} is not enabled", f"enable {name} first")
