"""The drive behind its object dictionary: power states, modes, halt, faults (CiA 402-2)."""

from collections.abc import Callable

from sim.cia402 import aborts
from sim.cia402.aborts import Abort
from sim.cia402.dictionary import Dictionary
from sim.cia402.homing import METHODS, HomingMode
from sim.cia402.modes import (
    CYCLIC,
    HALT,
    HOMING,
    INTERPOLATED,
    PROFILE_POSITION,
    PROFILE_VELOCITY,
    REACHED,
    Interpolated,
    Mode,
    ProfilePosition,
    ProfileVelocity,
)
from sim.cia402.options import Options
from sim.cia402.servo import Servo
from sim.cia402.states import POWERED, Leave, PowerStates, State
from sim.core.controller import LimitSwitch
from sim.core.devicetime import DeviceTime

FOLLOWING_ERROR_CODE = 0x8611
HOMING_ERROR_CODE = 0x8613
SYNC_LOST_CODE = 0x8700
COMMUNICATION_CODE = 0x8130

_GENERIC, _COMMUNICATION, _PROFILE = 0x01, 0x10, 0x20
_VOLTAGE, _REMOTE, _INTERNAL_LIMIT = 0x10, 0x200, 0x800

_POSITIVE = (0x6083, 0x6084, 0x6085, 0x609A)
"""Objects that a ramp is divided by."""
_FACTORS = tuple((index, sub) for index in (0x608F, 0x6091, 0x6092, 0x6096, 0x6097) for sub in (1, 2))


class Drive:
    """emergency: send an EMCY with this error code, and these bits in the error register; code 0: no error any more.
    changed: something that a PDO may carry has changed. phase_ns: of the control loop's ticks.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        time: DeviceTime,
        options: Options,
        phase_ns: int,
        emergency: Callable[[int, int], None],
        changed: Callable[[], None],
    ) -> None:
        self._dictionary = dictionary
        self._options = options
        self._emergency = emergency
        self._changed = changed
        self._control = 0
        self._after_stop: Callable[[], None] | None = None
        self.servo = Servo(dictionary, time, options, phase_ns, changed, self._ended, self._limit, self._strayed)
        self.states = PowerStates(dictionary.get, self._stop, self._state_changed, self._has_voltage)
        self._homing = HomingMode(dictionary, self.servo, options)
        self._homing.failed = lambda: emergency(HOMING_ERROR_CODE, _GENERIC | _PROFILE)
        interpolated = Interpolated(dictionary, self.servo, False, options.sync_missed)
        cyclic = Interpolated(dictionary, self.servo, True, options.sync_missed)
        interpolated.lost = cyclic.lost = lambda: self.fault(SYNC_LOST_CODE, _COMMUNICATION)
        self._modes: dict[int, Mode] = {
            0: Mode(dictionary, self.servo),
            PROFILE_POSITION: ProfilePosition(dictionary, self.servo),
            PROFILE_VELOCITY: ProfileVelocity(dictionary, self.servo),
            HOMING: self._homing,
            INTERPOLATED: interpolated,
            CYCLIC: cyclic,
        }
        for mode in self._modes.values():
            mode.leave()
        self._mode = 0
        self._connect_objects()

    def _connect_objects(self) -> None:
        reads, writes, servo = self._dictionary.reads, self._dictionary.writes, self.servo
        reads[0x6041, 0] = self.status
        reads[0x6061, 0] = lambda: self._mode
        reads[0x6502, 0] = lambda: sum(1 << mode - 1 for mode in self._options.modes)
        for index in (0x6062, 0x60FC):
            reads[index, 0] = lambda: round(servo.demand)
        for index in (0x6063, 0x6064):
            reads[index, 0] = lambda: round(servo.actual)
        reads[0x606B, 0] = lambda: servo.velocity_units(servo.speed)
        reads[0x606C, 0] = lambda: 0 if servo.stuck else servo.velocity_units(servo.speed)
        reads[0x60F4, 0] = lambda: round(servo.demand - servo.actual)
        reads[0x60FD, 0] = lambda: servo.terminals.word(servo.mechanical)
        writes[0x6040, 0] = self.control
        writes[0x6060, 0] = self._select
        writes[0x60FE, 1] = lambda value: servo.terminals.drive_outputs(value, self._dictionary.get(0x60FE, 2))
        writes[0x60FE, 2] = lambda value: servo.terminals.drive_outputs(self._dictionary.get(0x60FE, 1), value)
        writes[0x60FF, 0] = self._new_velocity
        for index in _POSITIVE:
            writes[index, 0] = _require_positive
        for key in _FACTORS:
            writes[key] = self._require_factor
        writes[0x6086, 0] = writes[0x60C0, 0] = writes[0x607E, 0] = writes[0x6082, 0] = _require_zero
        writes[0x6098, 0] = _require_method
        writes[0x60C2, 1] = _require_positive
        writes[0x60C2, 2] = _require_time_index

    # Controlword and statusword

    def status(self) -> int:
        """The statusword."""
        state = self.states.state
        word = state.value | _REMOTE | _VOLTAGE * self._has_voltage() | _INTERNAL_LIMIT * self.servo.internal_limit
        if state is State.ENABLED:
            bits = self._modes[self._mode].bits
            if self._control & HALT:
                bits = bits & ~REACHED | REACHED * (not self.servo.busy)
            return word | bits
        return word | REACHED * (state is State.QUICK_STOP and not self.servo.busy)

    def control(self, word: int) -> None:
        """A controlword has come."""
        before, self._control = self._control, word
        was_fault = self.states.state is State.FAULT
        self.states.order(word)
        if was_fault and self.states.state is State.DISABLED:
            self._dictionary.put(0x603F, 0, 0)
            self._emergency(0, 0)
        if self.states.state is State.ENABLED:
            mode, rising = self._modes[self._mode], word & ~before
            if rising & HALT:
                self._stop("quick stop" if self._dictionary.get(0x605D) == 2 else "slow down", lambda: None)
            mode.control(word, rising)
            if before & HALT and not word & HALT:
                mode.resume()
        self._changed()

    def _select(self, mode: int) -> None:
        """Object 0x6060: another mode of operation. What moves comes to rest by its ramp."""
        if mode not in (0, *self._options.modes):
            raise Abort(aborts.RANGE)
        if mode == self._mode:
            return
        enabled = self.states.state is State.ENABLED
        if enabled:
            self._modes[self._mode].leave()
            if self.servo.mover.moving:
                self.servo.slow_down(self.servo.acceleration(0x6084))
        self._mode = mode
        if enabled:
            self._modes[mode].enter()
        self._changed()

    def _new_velocity(self, value: int) -> None:
        self._dictionary.put(0x60FF, 0, value)
        if self._mode == PROFILE_VELOCITY and self.states.state is State.ENABLED and not self._control & HALT:
            self._modes[PROFILE_VELOCITY].resume()

    def _require_factor(self, value: int) -> None:
        if self.states.state in POWERED:
            raise Abort(aborts.DEVICE_STATE)
        _require_positive(value)

    def sync(self) -> None:
        """SYNC has come, and synchronous PDOs are in their objects."""
        if self.states.state is State.ENABLED and not self._control & HALT:
            self._modes[self._mode].sync()

    # What the states ask for

    def _has_voltage(self) -> bool:
        number = self._options.enable_input
        return number is None or self.servo.terminals.input(number)

    def _stop(self, how: Leave, then: Callable[[], None]) -> None:
        servo = self.servo
        if how == "at once":
            servo.let_go()
        if not servo.mover.moving:
            servo.forget()
            then()
            return
        self._after_stop = then
        servo.slow_down(servo.acceleration(0x6085 if how == "quick stop" else 0x6084))

    def _ended(self) -> None:
        then, self._after_stop = self._after_stop, None
        if then is not None:
            then()
        elif self.states.state is State.ENABLED and not self._control & HALT:
            self._modes[self._mode].ended()

    def _state_changed(self, before: State) -> None:
        after, mode = self.states.state, self._modes[self._mode]
        self._after_stop = None
        if before is State.ENABLED:
            mode.leave()
        if after not in POWERED:
            self.servo.let_go()
        if after is State.ENABLED:
            self.servo.internal_limit = False
            mode.enter()
        self._changed()

    def _limit(self, sign: int) -> None:
        """The motor runs into a limit switch: it stops by the quick stop ramp, and stays enabled."""
        servo = self.servo
        if self.states.state is State.ENABLED and self._modes[self._mode].limit(sign):
            return
        servo.internal_limit = True
        if servo.mover.moving and not servo.mover.slowing:
            servo.slow_down(servo.acceleration(0x6085))
        self._changed()

    # Faults

    def fault(self, code: int, register: int) -> None:
        """An error that the drive can not work with."""
        self._dictionary.put(0x603F, 0, code)
        self._emergency(code, register | _GENERIC)
        self.states.fault()
        self._changed()

    def _strayed(self) -> None:
        if self.states.state in POWERED:
            self.fault(FOLLOWING_ERROR_CODE, _PROFILE)

    def connection_lost(self) -> None:
        """The client is gone, or has stopped the node: the abort connection option code says what that means."""
        code = self._dictionary.get(0x6007)
        if code == 1:
            self.states.fault()
            self._dictionary.put(0x603F, 0, COMMUNICATION_CODE)
        elif code == 2:
            self.states.lose_voltage()
        elif code == 3 and self.states.state is State.ENABLED:
            self.states.quick_stop()
        self._changed()

    # Power, and the world

    def power_up(self) -> None:
        """The firmware begins: the position counts from here."""
        self._control = 0
        self._mode = self._dictionary.get(0x6060) if self._dictionary.get(0x6060) in self._modes else 0
        self.servo.offset = -self.servo.mechanical
        self.servo.internal_limit = False
        self.states.enter(State.NOT_READY)
        self.states.enter(State.DISABLED)

    def power_down(self) -> None:
        """Power is gone, or the node is reset."""
        self.states.enter(State.NOT_READY)
        self.servo.terminals.drive_outputs(0, 0xFFFF_FFFF)

    def set_input(self, number: int, level: bool) -> None:
        self.servo.terminals.set_input(number, level)
        if not self._has_voltage():
            self.states.lose_voltage()

    def set_limit(self, which: LimitSwitch) -> None:
        servo = self.servo
        servo.terminals.forced = None if which == "none" else which
        servo.mover.look_again()
        self._homing.released()
        speed = servo.speed
        negative, positive = servo.terminals.limits(servo.mechanical)
        if (speed < 0 and negative) or (speed > 0 and positive):
            self._limit(-1 if speed < 0 else 1)
        self._changed()


def _require_positive(value: int) -> None:
    if value <= 0:
        raise Abort(aborts.RANGE)


def _require_zero(value: int) -> None:
    if value:
        raise Abort(aborts.RANGE)


def _require_method(value: int) -> None:
    if value not in METHODS:
        raise Abort(aborts.RANGE)


def _require_time_index(value: int) -> None:
    """From microseconds to seconds."""
    if not -6 <= value <= 0:
        raise Abort(aborts.RANGE)
