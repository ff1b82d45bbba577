"""One axis of a light controller: at rest, or on legs of constant acceleration, in closed form."""

from collections.abc import Sequence

from orchestrator.clock.base import NS_PER_S
from sim.core.controller import CommandedMotion
from sim.core.devicetime import DeviceTime
from sim.core.ramps import RampSegment


class LightAxis:
    """An axis, whose state at an instant is computed when it is asked for. record: the list that gets its motions.

    Instants are ns of the controller's crystal; positions are counts.
    """

    def __init__(self, time: DeviceTime, name: str, record: list[CommandedMotion]) -> None:
        self.name = name
        self.enabled = True
        self.begin_ns = 0
        self.end_ns = 0
        """Of the last motion."""
        self._time = time
        self._record = record
        self._rest = 0.0
        self._origin = 0.0
        self._target = 0.0
        self._legs: list[RampSegment] = []
        self._is_slowing = False
        self._motion: CommandedMotion | None = None

    def start(self, begin_ns: int, target: float, legs: Sequence[tuple[float, float]]) -> None:
        """Begin a motion at `begin_ns`, now or later. legs: duration (s) and acceleration (counts/s²) of each."""
        at_s = velocity = 0.0
        position, self._legs = self._rest, []
        for duration_s, acceleration in legs:
            leg = RampSegment(at_s, position, velocity, acceleration)
            self._legs.append(leg)
            at_s += duration_s
            position, velocity = leg.x_at(at_s), leg.v_at(at_s)
        self._target, self._is_slowing = target, False
        self.begin_ns, self.end_ns = begin_ns, begin_ns + round(at_s * NS_PER_S)

    def brake(self, ramp: float) -> None:
        """Slow down to rest now, by a ramp in counts/s²; 0: stop dead. A motion that has not begun does not."""
        now_ns = self._time.now_ns()
        position, velocity = self.find_state(now_ns)
        if not self._legs:
            return
        if now_ns < self.begin_ns:
            self._legs = []
            return
        if self._is_slowing:
            return
        took_s = abs(velocity) / ramp if ramp else 0.0
        at_s = (now_ns - self.begin_ns) / NS_PER_S
        self._target = float(round(position + velocity * took_s / 2))
        self._legs = [RampSegment(at_s, position, velocity, -ramp if velocity > 0 else ramp)]
        self.end_ns, self._is_slowing = now_ns + round(took_s * NS_PER_S), True
        if self._motion is not None:
            self._motion.slowing_ns = self._time.clock.now_ns()
        self.find_state(now_ns)

    def find_state(self, now_ns: int) -> tuple[float, float]:
        """Return position and velocity (counts per second of the crystal) now; what has begun or ended is recorded."""
        if not self._legs or now_ns < self.begin_ns:
            return self._rest, 0.0
        if self._motion is None:
            self._motion = CommandedMotion(self.name, self._time.true_ns(self.begin_ns), self._rest)
            self._record.append(self._motion)
        if now_ns >= self.end_ns:
            self._motion.end_ns, self._motion.end_counts = self._time.true_ns(self.end_ns), self._target
            self._rest, self._legs, self._motion = self._target, [], None
            return self._rest, 0.0
        at_s = (now_ns - self.begin_ns) / NS_PER_S
        leg = next((leg for leg in reversed(self._legs) if leg.t <= at_s), self._legs[0])
        return leg.x_at(at_s), leg.v_at(at_s)

    def is_moving(self, now_ns: int) -> bool:
        """Whether its motion has begun and has not ended."""
        self.find_state(now_ns)
        return bool(self._legs) and now_ns >= self.begin_ns

    @property
    def physical_position(self) -> float:
        """Where it is, from where it was built."""
        return self.find_state(self._time.now_ns())[0] + self._origin

    def set_position(self, value: float) -> None:
        """Set the register of an axis at rest."""
        self._origin += self._rest - value
        self._rest = value

    @property
    def is_idle(self) -> bool:
        """Whether no motion is under way or to come."""
        self.find_state(self._time.now_ns())
        return not self._legs
