"""The homing mode: methods 17-30 by switches, 1-14 by the same ones and the index pulse behind them, 33 and 34 by the
index pulse alone, 35 and 37 where it stands (CiA 402-2; 15, 16, 31, 32 and 36 are reserved there)."""

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import Literal

from sim.cia402.dictionary import Dictionary
from sim.cia402.modes import FOLLOWING_ERROR, HALT, REACHED, START, Mode
from sim.cia402.mover import Mark
from sim.cia402.options import Options
from sim.cia402.profile import to_rest, to_speed
from sim.cia402.servo import Servo

_ATTAINED = 0x1000
_ERROR = FOLLOWING_ERROR

# By method: the direction in which the home switch is looked for, which of its ends is meant (0 the lower, 1 the
# upper), and the direction in which that is passed at last. With 19-22 it is active up to the end of the travel.
_BY_SWITCH: dict[int, tuple[int, int, int]] = {
    19: (1, 0, -1),
    20: (1, 0, 1),
    21: (-1, 1, 1),
    22: (-1, 1, -1),
    23: (1, 0, -1),
    24: (1, 0, 1),
    25: (1, 1, -1),
    26: (1, 1, 1),
    27: (-1, 1, 1),
    28: (-1, 1, -1),
    29: (-1, 0, 1),
    30: (-1, 0, -1),
}
_BY_LIMIT = {17: -1, 18: 1}
_BY_LIMIT_AND_INDEX = {1: -1, 2: 1}
_BY_INDEX = {33: -1, 34: 1}
_HERE = (35, 37)
_BY_SWITCH_AND_INDEX = {method - 16: way for method, way in _BY_SWITCH.items()}
METHODS = (*_BY_LIMIT_AND_INDEX, *_BY_SWITCH_AND_INDEX, *_BY_LIMIT, *_BY_SWITCH, *_BY_INDEX, *_HERE)

_FAST, _SLOW = 1, 2
"""Sub-indices of 0x6099."""


@dataclass(frozen=True, slots=True)
class _Leg:
    """A part of the way: in direction `sign` until one of `places` is passed; or until the limit switch of direction
    `release` is let go."""

    sign: int
    speed: int
    places: tuple[float, ...] = ()
    release: int = 0


Script = Generator[_Leg, float | None, float | None]
"""Gives legs, is told where each has passed what it looked for (None: it ran into a limit switch), and returns the
mechanical home position (None: there is none)."""


class HomingMode(Mode):
    """failed: called when the homing has gone wrong."""

    def __init__(self, dictionary: Dictionary, servo: Servo, options: Options) -> None:
        super().__init__(dictionary, servo)
        self._options = options
        self._state: Literal["idle", "running", "attained", "error"] = "idle"
        self._script: Script | None = None
        self._leg: _Leg | None = None
        self._result: float | None = None
        self.failed = lambda: None

    def enter(self) -> None:
        self._drop("idle")

    def leave(self) -> None:
        if self._state == "running":
            self._drop("idle")

    def _drop(self, state: Literal["idle", "attained", "error"]) -> None:
        self._state, self._script, self._leg, self.servo.wanted = state, None, None, []

    def control(self, word: int, rising: int) -> None:
        if rising & START and not word & HALT:
            self._begin()
        elif not word & START and self._state == "running":
            self._drop("idle")
            self.servo.slow_down(self._rate())

    def resume(self) -> None:
        if self._leg is not None:
            self.servo.at_tick(self._go)

    def _rate(self) -> float:
        return self.servo.acceleration(0x609A)

    def _begin(self) -> None:
        self._drop("idle")
        self._state, self._script = "running", self._plan(self.dictionary.get(0x6098))
        self._next(None, first=True)

    # Legs

    def _next(self, passed: float | None, first: bool = False) -> None:
        script = self._script
        if script is None:
            return
        try:
            self._leg = next(script) if first else script.send(passed)
        except StopIteration as end:
            self._finish(end.value)
            return
        self.servo.at_tick(self._go)

    def _go(self) -> None:
        leg, servo = self._leg, self.servo
        if leg is None:
            return
        if leg.release and not self._pressed(leg.release):
            self._passed(servo.mechanical)
            return
        ahead = [place for place in leg.places if leg.sign * (place - servo.mechanical) > 0]
        servo.wanted = [Mark(place, leg.sign, lambda p=place: self._passed(p)) for place in ahead]
        speed = leg.sign * servo.velocity(0x6099, leg.speed)
        servo.go(to_speed(servo.speed, speed, self._rate(), self._rate()))

    def _passed(self, place: float) -> None:
        if self._leg is not None:
            self._result = place
            self._stop()

    def _stop(self) -> None:
        self._leg, self.servo.wanted = None, []
        if self.servo.mover.moving:
            self.servo.mover.go(to_rest(self.servo.speed, self._rate()))
        else:
            self._next(self._result)

    def limit(self, sign: int) -> bool:
        if self._state != "running":
            return False
        if self._leg is not None and self._leg.sign == sign:
            self._result = None
            self._stop()
        return True

    def released(self) -> None:
        """A limit switch that was pressed from outside may have been let go."""
        leg = self._leg
        if leg is not None and leg.release and not self._pressed(leg.release):
            self._passed(self.servo.mechanical)

    def ended(self) -> None:
        if self._state == "running" and self._leg is None:
            self._next(self._result)

    def _finish(self, home: float | None) -> None:
        if home is None:
            self._drop("error")
            self.failed()
            return
        offset = self.dictionary.get(0x607C)
        at_home = offset if self._options.home_is_offset else -offset
        self.servo.offset = at_home - home
        self._drop("attained")

    def _pressed(self, sign: int) -> bool:
        return self.servo.terminals.limits(self.servo.mechanical)[sign > 0]

    # Methods

    def _plan(self, method: int) -> Script:
        if method in _HERE:
            return self._here()
        if method in _BY_LIMIT:
            return self._by_limit(_BY_LIMIT[method])
        if method in _BY_LIMIT_AND_INDEX:
            return self._by_limit_and_index(_BY_LIMIT_AND_INDEX[method])
        if method in _BY_INDEX:
            return self._by_index(_BY_INDEX[method])
        if method in _BY_SWITCH_AND_INDEX:
            return self._by_switch(*_BY_SWITCH_AND_INDEX[method], index=True)
        return self._by_switch(*_BY_SWITCH[method])

    def _here(self) -> Script:
        return self.servo.mechanical
        yield  # a script without legs

    def _by_limit(self, sign: int) -> Script:
        """Into the limit switch, and out of it slowly."""
        if not self._pressed(sign):
            yield _Leg(sign, _FAST)
        travel = self._options.travel
        places = (travel[sign > 0],) if travel is not None and self.servo.terminals.forced is None else ()
        return (yield _Leg(-sign, _SLOW, places, release=sign))

    def _by_index(self, sign: int) -> Script:
        return (yield _Leg(sign, _SLOW, (self._index_beyond(self.servo.mechanical, sign),)))

    def _index_beyond(self, place: float, sign: int) -> float:
        """The next index pulse from there."""
        every = self._options.index_every
        turns = place / every
        return (math.floor(turns) + 1 if sign > 0 else math.ceil(turns) - 1) * every

    def _by_limit_and_index(self, sign: int) -> Script:
        """Out of the limit switch, and on to the next index pulse."""
        if (yield from self._by_limit(sign)) is None:
            return None
        return (yield from self._by_index(-sign))

    def _by_switch(self, way: int, end: int, last: int, index: bool = False) -> Script:
        """To the home switch, back at a limit switch, and slowly over the end that is meant; or on to the index pulse
        behind that."""
        terminals, edges = self.servo.terminals, tuple(self.servo.terminals.edges())
        if not terminals.home(self.servo.mechanical):
            passed = yield _Leg(way, _FAST, edges)
            if passed is None and (yield _Leg(-way, _FAST, edges)) is None:
                return None
        switch = self._options.home_switch
        edge = None if switch is None else switch[end]
        if edge is None:
            return None
        if last * (edge - self.servo.mechanical) <= 0 and (yield _Leg(-last, _FAST, (edge,))) is None:
            return None
        return (yield _Leg(last, _SLOW, (self._index_beyond(edge, last) if index else edge,)))

    @property
    def bits(self) -> int:
        state = self._state
        if state == "running":
            return 0
        reached = REACHED * (not self.servo.busy and (state != "attained" or self.servo.settled()))
        return reached | _ATTAINED * (state == "attained") | _ERROR * (state == "error")
