"""The drive below its object dictionary: power states, modes, halt, faults (CiA 402-2)."""

from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_US, ClockTimer
from sim.cia402 import aborts
from sim.cia402.aborts import SdoAbort
from sim.cia402.dictionary import DriveDictionary
from sim.cia402.homing import METHODS, HomingMode
from sim.cia402.modes import (
    CYCLIC,
    HALT,
    HOMING,
    INTERPOLATED,
    PROFILE_POSITION,
    PROFILE_VELOCITY,
    REACHED,
    InterpolatedPosition,
    OperationMode,
    ProfilePosition,
    ProfileVelocity,
)
from sim.cia402.options import DriveOptions
from sim.cia402.probes import TouchProbes
from sim.cia402.servo import ServoEvents, ServoMotor
from sim.cia402.states import POWERED, Leave, PowerState, PowerStates
from sim.core.controller import LimitSwitch
from sim.core.devicetime import DeviceTime

FOLLOWING_ERROR_CODE = 0x8611
HOMING_ERROR_CODE = 0x8613
SYNC_LOST_CODE = 0x8700
COMMUNICATION_CODE = 0x8130

_GENERIC, _COMMUNICATION, _PROFILE = 0x01, 0x10, 0x20
_VOLTAGE, _REMOTE, _INTERNAL_LIMIT = 0x10, 0x200, 0x800

_POSITIVE = (0x6083, 0x6084, 0x6085, 0x609A)
"""Objects that are divisors of a ramp."""
_FACTORS = tuple((index, sub) for index in (0x608F, 0x6091, 0x6092, 0x6096, 0x6097) for sub in (1, 2))


@dataclass(frozen=True, slots=True)
class DriveEvents:
    """Calls of the drive.

    emergency: sends an EMCY with this error code, and these bits in the error register; code 0: no error is left.
    changed: a value that a PDO may carry has changed.
    """

    emergency: Callable[[int, int], None]
    changed: Callable[[], None]


class ServoDrive:
    """Power states, mode and motor of one drive.

    phase_ns: phase of the control loop's ticks.
    """

    def __init__(
        self,
        dictionary: DriveDictionary,
        time: DeviceTime,
        options: DriveOptions,
        phase_ns: int,
        events: DriveEvents,
    ) -> None:
        self._dictionary = dictionary
        self._options = options
        self._emergency = events.emergency
        self._changed = events.changed
        self._control = 0
        self._after_stop: Callable[[], None] | None = None
        self._quick_stop_end: ClockTimer | None = None
        self.servo = ServoMotor(
            dictionary,
            time,
            options,
            phase_ns,
            ServoEvents(events.changed, self._handle_motion_end, self._handle_limit, self._handle_following_error),
        )
        self.states = PowerStates(dictionary.get_value, self._stop_for_state, self._state_changed, self._has_voltage)
        self._probes = TouchProbes(dictionary, options, lambda: round(self.servo.actual_position), events.changed)
        self._homing = HomingMode(dictionary, self.servo, options)
        self._homing.failed = lambda: events.emergency(HOMING_ERROR_CODE, _GENERIC | _PROFILE)
        interpolated_position = InterpolatedPosition(dictionary, self.servo, cyclic=False, missed=options.sync_missed)
        cyclic = InterpolatedPosition(dictionary, self.servo, cyclic=True, missed=options.sync_missed)
        interpolated_position.sync_lost = cyclic.sync_lost = lambda: self.enter_fault(SYNC_LOST_CODE, _COMMUNICATION)
        self._modes: dict[int, OperationMode] = {
            0: OperationMode(dictionary, self.servo),
            PROFILE_POSITION: ProfilePosition(dictionary, self.servo),
            PROFILE_VELOCITY: ProfileVelocity(dictionary, self.servo),
            HOMING: self._homing,
            INTERPOLATED: interpolated_position,
            CYCLIC: cyclic,
        }
        for mode in self._modes.values():
            mode.leave_mode()
        self._mode = 0
        self._connect_objects()

    def _connect_objects(self) -> None:
        reads, writes, servo = self._dictionary.reads, self._dictionary.writes, self.servo
        reads[0x6041, 0] = self.status_word
        reads[0x6061, 0] = lambda: self._mode
        reads[0x6502, 0] = lambda: sum(1 << mode - 1 for mode in self._options.modes)
        for index in (0x6062, 0x60FC):
            reads[index, 0] = lambda: round(servo.demand_position)
        for index in (0x6063, 0x6064):
            reads[index, 0] = lambda: round(servo.actual_position)
        reads[0x606B, 0] = lambda: servo.velocity_units(servo.demand_speed)
        reads[0x606C, 0] = lambda: 0 if servo.is_stuck else servo.velocity_units(servo.demand_speed)
        reads[0x60F4, 0] = lambda: round(servo.demand_position - servo.actual_position)
        reads[0x60FD, 0] = lambda: servo.terminals.input_word(servo.mechanical_position)
        writes[0x6040, 0] = self.handle_controlword
        writes[0x6060, 0] = self._select_mode
        writes[0x60FE, 1] = lambda value: servo.terminals.drive_outputs(value, self._dictionary.get_value(0x60FE, 2))
        writes[0x60FE, 2] = lambda value: servo.terminals.drive_outputs(self._dictionary.get_value(0x60FE, 1), value)
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

    def status_word(self) -> int:
        """The statusword."""
        state = self.states.state
        word = state.value | _REMOTE | _VOLTAGE * self._has_voltage() | _INTERNAL_LIMIT * self.servo.internal_limit
        if state is PowerState.ENABLED:
            bits = self._modes[self._mode].status_bits
            if self._control & HALT:
                bits = bits & ~REACHED | REACHED * (not self.servo.is_busy)
            return word | bits
        return word | REACHED * (state is PowerState.QUICK_STOP and not self.servo.is_busy)

    def handle_controlword(self, word: int) -> None:
        """Process a controlword."""
        old_word, self._control = self._control, word
        was_fault = self.states.state is PowerState.FAULT
        self.states.handle_controlword(word)
        if was_fault and self.states.state is PowerState.DISABLED:
            self._dictionary.put_value(0x603F, 0, 0)
            self._emergency(0, 0)
        if self.states.state is PowerState.ENABLED:
            mode, rising = self._modes[self._mode], word & ~old_word
            if rising & HALT:
                self._stop_motion(
                    "quick stop" if self._dictionary.get_value(0x605D) == 2 else "slow down", lambda: None
                )
            mode.handle_controlword(word, rising)
            if old_word & HALT and not word & HALT:
                mode.resume_motion()
        self._changed()

    def _select_mode(self, mode: int) -> None:
        """Object 0x6060: select a mode of operation. A motion in progress stops by its ramp."""
        if mode not in (0, *self._options.modes):
            raise SdoAbort(aborts.RANGE)
        if mode == self._mode:
            return
        is_enabled = self.states.state is PowerState.ENABLED
        if is_enabled:
            self._modes[self._mode].leave_mode()
            if self.servo.mover.is_moving:
                self.servo.slow_down(self.servo.read_acceleration(0x6084))
        self._mode = mode
        if is_enabled:
            self._modes[mode].enter_mode()
        self._changed()

    def _new_velocity(self, value: int) -> None:
        self._dictionary.put_value(0x60FF, 0, value)
        if self._mode == PROFILE_VELOCITY and self.states.state is PowerState.ENABLED and not self._control & HALT:
            self._modes[PROFILE_VELOCITY].resume_motion()

    def _require_factor(self, value: int) -> None:
        if self.states.state in POWERED:
            raise SdoAbort(aborts.DEVICE_STATE)
        _require_positive(value)

    def handle_sync(self) -> None:
        """Process SYNC; the synchronous PDOs are in their objects."""
        if self.states.state is PowerState.ENABLED and not self._control & HALT:
            self._modes[self._mode].handle_sync()

    # Callbacks of the power states

    def _has_voltage(self) -> bool:
        number = self._options.enable_input
        return number is None or self.servo.terminals.input_level(number)

    def _stop_for_state(self, way: Leave, then: Callable[[], None]) -> None:
        """Stop because the power state requires it. A quick stop is completed some time after standstill, so that
        clients see its state also at rest."""
        if self.states.state is not PowerState.QUICK_STOP:
            self._stop_motion(way, then)
            return

        def await_end() -> None:
            self._quick_stop_end = self.servo.time.call_after(self._options.quick_stop_hold_us * NS_PER_US, then)

        self._stop_motion(way, await_end)

    def _stop_motion(self, way: Leave, then: Callable[[], None]) -> None:
        servo = self.servo
        if way == "at once":
            servo.switch_off()
        if not servo.mover.is_moving:
            servo.cancel_order()
            then()
            return
        self._after_stop = then
        servo.slow_down(servo.read_acceleration(0x6085 if way == "quick stop" else 0x6084))

    def _handle_motion_end(self) -> None:
        act, self._after_stop = self._after_stop, None
        if act is not None:
            act()
        elif self.states.state is PowerState.ENABLED and not self._control & HALT:
            self._modes[self._mode].handle_motion_end()

    def _state_changed(self, before: PowerState) -> None:
        state_after, mode = self.states.state, self._modes[self._mode]
        self._after_stop = None
        if self._quick_stop_end is not None:
            self._quick_stop_end.cancel()
            self._quick_stop_end = None
        if before is PowerState.ENABLED:
            mode.leave_mode()
        if state_after not in POWERED:
            self.servo.switch_off()
        if state_after is PowerState.ENABLED:
            self.servo.internal_limit = False
            mode.enter_mode()
        self._changed()

    def _handle_limit(self, sign: int) -> None:
        """The motor reaches a limit switch: stop by the quick stop ramp, and stay enabled."""
        servo = self.servo
        if self.states.state is PowerState.ENABLED and self._modes[self._mode].handle_limit(sign):
            return
        servo.internal_limit = True
        if servo.mover.is_moving and not servo.mover.slowing:
            servo.slow_down(servo.read_acceleration(0x6085))
        self._changed()

    # Faults

    def enter_fault(self, code: int, register: int) -> None:
        """Enter the fault state after an error that prevents operation."""
        self._dictionary.put_value(0x603F, 0, code)
        self._emergency(code, register | _GENERIC)
        self.states.enter_fault()
        self._changed()

    def _handle_following_error(self) -> None:
        if self.states.state in POWERED:
            self.enter_fault(FOLLOWING_ERROR_CODE, _PROFILE)

    def connection_lost(self) -> None:
        """The client is lost, or has stopped the node: act as the abort connection option code requires."""
        code = self._dictionary.get_value(0x6007)
        if code == 1:
            self.states.enter_fault()
            self._dictionary.put_value(0x603F, 0, COMMUNICATION_CODE)
        elif code == 2:
            self.states.lose_voltage()
        elif code == 3 and self.states.state is PowerState.ENABLED:
            self.states.quick_stop()
        self._changed()

    # Power and environment

    def power_up(self) -> None:
        """Start the firmware: the position counts from here."""
        self._control = 0
        self._mode = self._dictionary.get_value(0x6060) if self._dictionary.get_value(0x6060) in self._modes else 0
        self.servo.offset = -self.servo.mechanical_position
        self.servo.internal_limit = False
        self._probes.switch_off()
        self.states.enter_state(PowerState.NOT_READY)
        self.states.enter_state(PowerState.DISABLED)

    def power_down(self) -> None:
        """Handle a power loss or a reset of the node."""
        self.states.enter_state(PowerState.NOT_READY)
        self.servo.terminals.drive_outputs(0, 0xFFFF_FFFF)

    def set_input(self, number: int, *, level: bool) -> None:
        level_before = self.servo.terminals.input_level(number)
        self.servo.terminals.set_input(number, level=level)
        if level_before != level:
            self._probes.handle_input(number, level=level)
        if not self._has_voltage():
            self.states.lose_voltage()

    def set_limit(self, which: LimitSwitch) -> None:
        servo = self.servo
        servo.terminals.forced = None if which == "none" else which
        servo.mover.recheck_marks()
        self._homing.handle_switch_release()
        speed = servo.demand_speed
        negative, positive = servo.terminals.limit_states(servo.mechanical_position)
        if (speed < 0 and negative) or (speed > 0 and positive):
            self._handle_limit(-1 if speed < 0 else 1)
        self._changed()


def _require_positive(value: int) -> None:
    if value <= 0:
        raise SdoAbort(aborts.RANGE)


def _require_zero(value: int) -> None:
    if value:
        raise SdoAbort(aborts.RANGE)


def _require_method(value: int) -> None:
    if value not in METHODS:
        raise SdoAbort(aborts.RANGE)


def _require_time_index(value: int) -> None:
    """Convert microseconds to seconds."""
    if not -6 <= value <= 0:
        raise SdoAbort(aborts.RANGE)
