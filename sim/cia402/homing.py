"""Homing mode: methods 17-30 by switches, 1-14 by the same switches and the next index pulse, 33 and 34 by the index
pulse alone, 35 and 37 at the present position (CiA 402-2; 15, 16, 31, 32 and 36 are reserved there)."""

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import Literal

from sim.cia402.dictionary import DriveDictionary
from sim.cia402.modes import FOLLOWING_ERROR, HALT, REACHED, START, OperationMode
from sim.cia402.mover import PositionMark
from sim.cia402.options import DriveOptions
from sim.cia402.profile import to_rest, to_speed
from sim.cia402.servo import ServoMotor

_ATTAINED = 0x1000
_ERROR = FOLLOWING_ERROR

# By method: the direction of the search for the home switch, which of its ends is used (0 the lower, 1 the upper), and
# the direction of the final pass over that end. With 19-22 the switch is active up to the end of the travel.
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
class _SearchLeg:
    """One leg of the search: in direction `sign` until one of `places` is passed; or until the limit switch of
    direction `release` opens."""

    sign: int
    speed: int
    places: tuple[float, ...] = ()
    release: int = 0


Script = Generator[_SearchLeg, float | None, float | None]
"""Yields legs, receives the position where each has found its target (None: it reached a limit switch), and returns
the mechanical home position (None: there is none)."""


class HomingMode(OperationMode):
    """Homing as a mode of operation.

    failed: called when the homing fails."""

    def __init__(self, dictionary: DriveDictionary, servo: ServoMotor, options: DriveOptions) -> None:
        super().__init__(dictionary, servo)
        self._options = options
        self._state: Literal["idle", "running", "attained", "error"] = "idle"
        self._script: Script | None = None
        self._leg: _SearchLeg | None = None
        self._result: float | None = None
        self.failed = lambda: None

    def enter_mode(self) -> None:
        self._cancel_search("idle")

    def leave_mode(self) -> None:
        if self._state == "running":
            self._cancel_search("idle")

    def _cancel_search(self, state: Literal["idle", "attained", "error"]) -> None:
        self._state, self._script, self._leg, self.servo.wanted = state, None, None, []

    def handle_controlword(self, word: int, rising: int) -> None:
        if rising & START and not word & HALT:
            self._begin_search()
        elif not word & START and self._state == "running":
            self._cancel_search("idle")
            self.servo.slow_down(self._ramp_rate())

    def resume_motion(self) -> None:
        if self._leg is not None:
            self.servo.run_at_tick(self._start_leg)

    def _ramp_rate(self) -> float:
        return self.servo.read_acceleration(0x609A)

    def _begin_search(self) -> None:
        self._cancel_search("idle")
        self._state, self._script = "running", self._plan_method(self.dictionary.get_value(0x6098))
        self._next_leg(None, first=True)

    # Legs

    def _next_leg(self, passed: float | None, *, first: bool = False) -> None:
        script = self._script
        if script is None:
            return
        try:
            self._leg = next(script) if first else script.send(passed)
        except StopIteration as end:
            self._finish_search(end.value)
            return
        self.servo.run_at_tick(self._start_leg)

    def _start_leg(self) -> None:
        leg, servo = self._leg, self.servo
        if leg is None:
            return
        if leg.release and not self._is_pressed(leg.release):
            self._handle_passed(servo.mechanical_position)
            return
        places_ahead = [position for position in leg.places if leg.sign * (position - servo.mechanical_position) > 0]
        servo.wanted = [
            PositionMark(position, leg.sign, lambda p=position: self._handle_passed(p)) for position in places_ahead
        ]
        speed = leg.sign * servo.read_velocity(0x6099, leg.speed)
        servo.follow_plan(to_speed(servo.demand_speed, speed, self._ramp_rate(), self._ramp_rate()))

    def _handle_passed(self, place: float) -> None:
        if self._leg is not None:
            self._result = place
            self._stop_leg()

    def _stop_leg(self) -> None:
        self._leg, self.servo.wanted = None, []
        if self.servo.mover.is_moving:
            self.servo.mover.start_plan(to_rest(self.servo.demand_speed, self._ramp_rate()))
        else:
            self._next_leg(self._result)

    def handle_limit(self, sign: int) -> bool:
        if self._state != "running":
            return False
        if self._leg is not None and self._leg.sign == sign:
            self._result = None
            self._stop_leg()
        return True

    def handle_switch_release(self) -> None:
        """Handle the opening of a limit switch that was pressed from outside."""
        leg = self._leg
        if leg is not None and leg.release and not self._is_pressed(leg.release):
            self._handle_passed(self.servo.mechanical_position)

    def handle_motion_end(self) -> None:
        if self._state == "running" and self._leg is None:
            self._next_leg(self._result)

    def _finish_search(self, home: float | None) -> None:
        if home is None:
            self._cancel_search("error")
            self.failed()
            return
        offset = self.dictionary.get_value(0x607C)
        at_home = offset if self._options.home_is_offset else -offset
        self.servo.offset = at_home - home
        self._cancel_search("attained")

    def _is_pressed(self, sign: int) -> bool:
        return self.servo.terminals.limit_states(self.servo.mechanical_position)[sign > 0]

    # Methods

    def _plan_method(self, method: int) -> Script:
        if method in _HERE:
            return self._home_here()
        if method in _BY_LIMIT:
            return self._by_limit(_BY_LIMIT[method])
        if method in _BY_LIMIT_AND_INDEX:
            return self._by_limit_and_index(_BY_LIMIT_AND_INDEX[method])
        if method in _BY_INDEX:
            return self._by_index(_BY_INDEX[method])
        if method in _BY_SWITCH_AND_INDEX:
            return self._by_switch(*_BY_SWITCH_AND_INDEX[method], index=True)
        return self._by_switch(*_BY_SWITCH[method])

    def _home_here(self) -> Script:
        return self.servo.mechanical_position
        yield  # a script without legs

    def _by_limit(self, sign: int) -> Script:
        """Move into the limit switch, and slowly out of it."""
        if not self._is_pressed(sign):
            yield _SearchLeg(sign, _FAST)
        travel = self._options.travel
        places = (travel[sign > 0],) if travel is not None and self.servo.terminals.forced is None else ()
        return (yield _SearchLeg(-sign, _SLOW, places, release=sign))

    def _by_index(self, sign: int) -> Script:
        return (yield _SearchLeg(sign, _SLOW, (self._index_beyond(self.servo.mechanical_position, sign),)))

    def _index_beyond(self, place: float, sign: int) -> float:
        """Return the next index pulse from there."""
        every = self._options.index_every
        turns = place / every
        return (math.floor(turns) + 1 if sign > 0 else math.ceil(turns) - 1) * every

    def _by_limit_and_index(self, sign: int) -> Script:
        """Move out of the limit switch, and on to the next index pulse."""
        if (yield from self._by_limit(sign)) is None:
            return None
        return (yield from self._by_index(-sign))

    def _by_switch(self, direction: int, end: int, last: int, *, index: bool = False) -> Script:
        """Move to the home switch, reverse at a limit switch, and move slowly over the selected end; or on to the
        next index pulse."""
        terminals, edges = self.servo.terminals, tuple(self.servo.terminals.home_edges())
        if not terminals.home_state(self.servo.mechanical_position):
            passed_edge = yield _SearchLeg(direction, _FAST, edges)
            if passed_edge is None and (yield _SearchLeg(-direction, _FAST, edges)) is None:
                return None
        switch = self._options.home_switch
        edge = None if switch is None else switch[end]
        if edge is None:
            return None
        if last * (edge - self.servo.mechanical_position) <= 0:
            # Where it stands on the edge itself, as after its last homing, that is left behind at the next count.
            left_place = edge - last if self.servo.mechanical_position == edge else edge
            if (yield _SearchLeg(-last, _FAST, (left_place,))) is None:
                return None
        return (yield _SearchLeg(last, _SLOW, (self._index_beyond(edge, last) if index else edge,)))

    @property
    def status_bits(self) -> int:
        state = self._state
        if state == "running":
            return 0
        reach_bit = REACHED * (not self.servo.is_busy and (state != "attained" or self.servo.is_settled()))
        return reach_bit | _ATTAINED * (state == "attained") | _ERROR * (state == "error")
