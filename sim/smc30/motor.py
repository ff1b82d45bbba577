"""Motor commands: distance, start condition and stop condition (L1957-L2246)."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from sim.smc30.drive import RunEnd, StepGenerator, StepOrder
from sim.smc30.expressions import OperandValues
from sim.smc30.inputs import InputLevels
from sim.smc30.options import IndexerOptions
from sim.smc30.parameters import MotorParameters
from sim.smc30.profile import StepProfile, constant_profile
from sim.smc30.statements import (
    ArmMove,
    FallingInput,
    Motor,
    MoveAnalogue,
    MoveSteps,
    RunOn,
    SearchHome,
    StartCondition,
    StopCondition,
)
from sim.smc30.tempo import PausableTimer

Done = Callable[[], None]
Activity = Callable[[Done], None]
"""Begins an activity that takes time; its argument is called once at the end, perhaps immediately."""

_FRACTION = 10_000
_HOME_INPUT = 3
_NS_PER_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class _MotorOrder:
    """A motor command as interpreted: present parameters, and the steps still open if it moves to a position."""

    sign: int
    steps: float
    target: int | None
    build_profile: Callable[[float], StepProfile]
    start_rate: float
    slope: float


@dataclass(slots=True)
class UnitConversion:
    """con: steps per unit in ten-thousandths, and the fraction of a step carried over (L3048-L3114)."""

    factor: int | None = None
    remainder: int = 0

    def relative_steps(self, units: int) -> int:
        """Return the signed steps of a relative move; the fraction is carried over to the next one."""
        return units if self.factor is None else self._take_whole_steps(units * self.factor + self.remainder)

    def absolute_counter(self, units: int) -> int:
        """Return the counter value of an absolute move; the missing fraction is carried over."""
        return units if self.factor is None else self._take_whole_steps(units * self.factor)

    def _take_whole_steps(self, total: int) -> int:
        steps = abs(total) // _FRACTION * (-1 if total < 0 else 1)
        self.remainder = total - steps * _FRACTION
        return steps


class MotorCommands:
    """Executes motor commands one at a time; `overflowed` is called when the counter's limit ends one."""

    def __init__(
        self,
        options: IndexerOptions,
        tempo: PausableTimer,
        drive: StepGenerator,
        values: OperandValues,
        overflowed: Callable[[], None],
    ) -> None:
        self._tempo = tempo
        self._drive = drive
        self._values = values
        self._inputs: InputLevels = values.inputs
        self._overflowed = overflowed
        self._latency_ns = round(options.start_latency_ms * _NS_PER_MS)
        self._watches_eot = options.home_input == "eot"
        self.armed: ArmMove | None = None
        self.conversion = UnitConversion()
        self._awaited: StartCondition | None = None
        self._stop: StopCondition | None = None
        self._stop_was_high = False
        self._homing = False
        self._go: Callable[[], None] | None = None

    @property
    def _motor_parameters(self) -> MotorParameters:
        return self._values.parameters

    def prepare_motion(self, statement: Motor) -> Activity:
        """Interpret a motor command; `StatementRefused` if its registers cannot be interpreted."""
        if isinstance(statement, SearchHome):
            return lambda on_end: self._start_homing(statement.sign, on_end)
        order = self._build_order(statement)
        armed_move, self.armed = self.armed, None
        return lambda on_end: self._begin_order(order, armed_move, on_end)

    def _build_order(self, statement: MoveSteps | MoveAnalogue | RunOn) -> _MotorOrder:
        parameters = self._motor_parameters
        start, top, ramp, slope = parameters.start, parameters.top, parameters.ramp_steps, parameters.acceleration

        def build_profile(steps: float) -> StepProfile:
            frozen = MotorParameters(start, top, "R", ramp)
            return frozen.move_profile(steps)

        if isinstance(statement, RunOn):
            return _MotorOrder(
                sign=statement.sign,
                steps=math.inf,
                target=None,
                build_profile=build_profile,
                start_rate=start,
                slope=slope,
            )
        units = statement.sign * self._command_units(statement)
        if statement.absolute:
            return _MotorOrder(
                sign=0,
                steps=0,
                target=self.conversion.absolute_counter(units),
                build_profile=build_profile,
                start_rate=start,
                slope=slope,
            )
        steps = self.conversion.relative_steps(units)
        return _MotorOrder(
            sign=-1 if steps < 0 else 1,
            steps=abs(steps),
            target=None,
            build_profile=build_profile,
            start_rate=start,
            slope=slope,
        )

    def _command_units(self, statement: MoveSteps | MoveAnalogue) -> int:
        if isinstance(statement, MoveAnalogue):
            return self._inputs.scale_level(statement.amount)
        return statement.amount if isinstance(statement.amount, int) else self._values.read_operand(statement.amount)

    def _begin_order(self, order: _MotorOrder, armed: ArmMove | None, done: Done) -> None:
        stop = None if armed is None else armed.stop

        def begin_motion() -> None:
            self._start_run(order, stop, done)

        if armed is None or armed.start is None:
            begin_motion()
            return
        self._go, self._awaited = begin_motion, armed.start
        self._check_start()

    def _check_start(self) -> None:
        if self._awaited is None or self._drive.held or not self._inputs.is_fulfilled(self._awaited):
            return
        self._awaited = None
        if self._latency_ns:
            self._tempo.call_after(self._latency_ns, self._handle_start)
        else:
            self._handle_start()

    def _handle_start(self) -> None:
        go, self._go = self._go, None
        if go is not None:
            go()

    def _start_run(self, order: _MotorOrder, stop: StopCondition | None, done: Done) -> None:
        sign, steps = order.sign, order.steps
        if order.target is not None:
            way = order.target - self._drive.position_counter
            sign, steps = (-1 if way < 0 else 1), abs(way)
        self._stop = stop
        self._stop_was_high = isinstance(stop, FallingInput) and self._inputs.user_level(stop.input)
        build_profile, start_rate, slope = order.build_profile, order.start_rate, order.slope
        self._drive.start_run(
            StepOrder(
                sign=sign,
                steps=steps,
                build_profile=build_profile,
                start_rate=start_rate,
                slope=slope,
                ended=lambda end: self._handle_run_end(end, done),
            )
        )
        self._check_stop()

    def _handle_run_end(self, end: RunEnd, done: Done) -> None:
        self._stop = None
        if end is RunEnd.OVERFLOW:
            self._overflowed()
        else:
            done()

    def _start_homing(self, sign: int, done: Done) -> None:
        """Run at the start rate until the home input is active; then set the counter to zero (L2076-L2086)."""
        rate = self._motor_parameters.start

        def handle_home_end(end: RunEnd) -> None:
            self._homing = False
            if end is RunEnd.DONE or (end is RunEnd.SWITCH and self._watches_eot):
                self._drive.set_counter(0)
                self.conversion.remainder = 0
            self._handle_run_end(end, done)

        self._homing = True
        order = StepOrder(
            sign=sign,
            steps=math.inf,
            build_profile=lambda steps: constant_profile(steps, rate),
            start_rate=rate,
            slope=0.0,
            ended=handle_home_end,
        )
        self._drive.start_run(order)
        self._check_home()

    def _check_home(self) -> None:
        if self._homing and not self._watches_eot and not self._drive.held and not self._inputs.user_level(_HOME_INPUT):
            self._drive.halt_run(RunEnd.DONE)

    def _check_stop(self) -> None:
        stop = self._stop
        if stop is None or self._drive.held:
            return
        if isinstance(stop, FallingInput):
            high = self._inputs.user_level(stop.input)
            is_fulfilled = self._stop_was_high and not high
            self._stop_was_high = high
        else:
            is_fulfilled = self._inputs.is_fulfilled(stop)
        if is_fulfilled:
            self._stop = None
            self._drive.ramp_down()

    def inputs_changed(self) -> None:
        """Evaluate the start, stop and home conditions again."""
        self._check_home()
        self._check_stop()
        self._check_start()

    def abort_motion(self) -> None:
        """Cancel the pending start and the arming (K, Z)."""
        self.armed = None
        self._awaited = None
        self._go = None
        self._stop = None
        self._homing = False
