"""Motor commands: how far, when to start, and what stops them (L1957-L2246)."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from sim.smc30.drive import Drive, End
from sim.smc30.expressions import Values
from sim.smc30.inputs import Inputs
from sim.smc30.options import UnitOptions
from sim.smc30.parameters import Parameters
from sim.smc30.profile import Profile, constant
from sim.smc30.statements import (
    Arm,
    Falling,
    Home,
    Motor,
    Move,
    MoveAnalogue,
    RunOn,
    StartCondition,
    StopCondition,
)
from sim.smc30.tempo import Tempo

Done = Callable[[], None]
Activity = Callable[[Done], None]
"""Begins something that takes time; its argument is called once, when that is over, perhaps at once."""

_FRACTION = 10_000
_HOME_INPUT = 3
_NS_PER_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class _Order:
    """A motor command as interpreted: parameters of this moment, steps still open if they go to a position."""

    sign: int
    steps: float
    target: int | None
    again: Callable[[float], Profile]
    start_rate: float
    slope: float


@dataclass(slots=True)
class Conversion:
    """con: steps per unit in ten-thousandths, and the fraction of a step that is owed (L3048-L3114)."""

    factor: int | None = None
    remainder: int = 0

    def relative(self, units: int) -> int:
        """Signed steps of a relative move; the fraction is kept for the next one."""
        return units if self.factor is None else self._whole(units * self.factor + self.remainder)

    def absolute(self, units: int) -> int:
        """Counter value of an absolute move; the fraction that it falls short is owed."""
        return units if self.factor is None else self._whole(units * self.factor)

    def _whole(self, total: int) -> int:
        steps = abs(total) // _FRACTION * (-1 if total < 0 else 1)
        self.remainder = total - steps * _FRACTION
        return steps


class MotorCommands:
    """Executes motor commands one at a time; `overflowed` is called when the counter's limit ends one."""

    def __init__(
        self,
        options: UnitOptions,
        tempo: Tempo,
        drive: Drive,
        values: Values,
        overflowed: Callable[[], None],
    ) -> None:
        self._tempo = tempo
        self._drive = drive
        self._values = values
        self._inputs: Inputs = values.inputs
        self._overflowed = overflowed
        self._latency_ns = round(options.start_latency_ms * _NS_PER_MS)
        self._watches_eot = options.home_input == "eot"
        self.armed: Arm | None = None
        self.conversion = Conversion()
        self._awaited: StartCondition | None = None
        self._stop: StopCondition | None = None
        self._stop_was_high = False
        self._homing = False
        self._go: Callable[[], None] | None = None

    @property
    def _parameters(self) -> Parameters:
        return self._values.parameters

    def prepare(self, statement: Motor) -> Activity:
        """Interpret a motor command; `Refused` if its registers cannot be."""
        if isinstance(statement, Home):
            return lambda done: self._home(statement.sign, done)
        order = self._order(statement)
        armed, self.armed = self.armed, None
        return lambda done: self._begin(order, armed, done)

    def _order(self, statement: Move | MoveAnalogue | RunOn) -> _Order:
        parameters = self._parameters
        start, top, ramp, slope = parameters.start, parameters.top, parameters.ramp, parameters.slope

        def again(steps: float) -> Profile:
            frozen = Parameters(start, top, "R", ramp)
            return frozen.profile(steps)

        if isinstance(statement, RunOn):
            return _Order(statement.sign, math.inf, None, again, start, slope)
        units = statement.sign * self._units(statement)
        if statement.absolute:
            return _Order(0, 0, self.conversion.absolute(units), again, start, slope)
        steps = self.conversion.relative(units)
        return _Order(-1 if steps < 0 else 1, abs(steps), None, again, start, slope)

    def _units(self, statement: Move | MoveAnalogue) -> int:
        if isinstance(statement, MoveAnalogue):
            return self._inputs.scaled(statement.amount)
        return statement.amount if isinstance(statement.amount, int) else self._values.read(statement.amount)

    def _begin(self, order: _Order, armed: Arm | None, done: Done) -> None:
        stop = None if armed is None else armed.stop

        def go() -> None:
            self._launch(order, stop, done)

        if armed is None or armed.start is None:
            go()
            return
        self._go, self._awaited = go, armed.start
        self._check_start()

    def _check_start(self) -> None:
        if self._awaited is None or self._drive.held or not self._inputs.fulfilled(self._awaited):
            return
        self._awaited = None
        if self._latency_ns:
            self._tempo.after(self._latency_ns, self._started)
        else:
            self._started()

    def _started(self) -> None:
        go, self._go = self._go, None
        if go is not None:
            go()

    def _launch(self, order: _Order, stop: StopCondition | None, done: Done) -> None:
        sign, steps = order.sign, order.steps
        if order.target is not None:
            way = order.target - self._drive.counter
            sign, steps = (-1 if way < 0 else 1), abs(way)
        self._stop = stop
        self._stop_was_high = isinstance(stop, Falling) and self._inputs.user(stop.input)
        self._drive.start(sign, steps, order.again, order.start_rate, order.slope, lambda end: self._ended(end, done))
        self._check_stop()

    def _ended(self, end: End, done: Done) -> None:
        self._stop = None
        if end is End.OVERFLOW:
            self._overflowed()
        else:
            done()

    def _home(self, sign: int, done: Done) -> None:
        """At the start rate until the home input is active; then the counter is zero (L2076-L2086)."""
        rate = self._parameters.start

        def ended(end: End) -> None:
            self._homing = False
            if end is End.DONE or (end is End.SWITCH and self._watches_eot):
                self._drive.set_counter(0)
                self.conversion.remainder = 0
            self._ended(end, done)

        self._homing = True
        self._drive.start(sign, math.inf, lambda steps: constant(steps, rate), rate, 0.0, ended)
        self._check_home()

    def _check_home(self) -> None:
        if self._homing and not self._watches_eot and not self._drive.held and not self._inputs.user(_HOME_INPUT):
            self._drive.halt(End.DONE)

    def _check_stop(self) -> None:
        stop = self._stop
        if stop is None or self._drive.held:
            return
        if isinstance(stop, Falling):
            high = self._inputs.user(stop.input)
            fulfilled = self._stop_was_high and not high
            self._stop_was_high = high
        else:
            fulfilled = self._inputs.fulfilled(stop)
        if fulfilled:
            self._stop = None
            self._drive.ramp_down()

    def inputs_changed(self) -> None:
        """Look at the inputs again: start, stop and home conditions."""
        self._check_home()
        self._check_stop()
        self._check_start()

    def abort(self) -> None:
        """Forget what waits for a start, and the arming (K, Z)."""
        self.armed = None
        self._awaited = None
        self._go = None
        self._stop = None
        self._homing = False
