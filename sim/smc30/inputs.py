"""User inputs with their filter, and analogue inputs (L593-L767)."""

from collections.abc import Callable

from orchestrator.clock.base import ClockTimer
from sim.core.devicetime import DeviceTime
from sim.smc30.statements import AnalogueThreshold, InputContact, ScaledInput, StartCondition

USER_INPUTS = 3
ANALOGUE_INPUTS = 6
_STEPS_PER_VOLT = 50
_FULL_SCALE = 255
_LOGIC_ONE = 125  # 2.5 V (L2731)


class InputLevels:
    """Levels as the firmware sees them; `changed` is called on every change.

    poll_ns: period in which the firmware polls the user inputs, `phase_ns` after whole periods of device time; 0:
    continuously.
    """

    def __init__(
        self, time: DeviceTime, filter_ns: int, poll_ns: int, phase_ns: int, changed: Callable[[], None]
    ) -> None:
        self._time = time
        self._filter_ns = filter_ns
        self._poll_ns = poll_ns
        self._phase_ns = phase_ns
        self._changed = changed
        self._wire = [False] * (USER_INPUTS + 1)
        self._pending: dict[int, ClockTimer] = {}
        self._user = [False] * (USER_INPUTS + 1)
        self._analogue = [0] * (ANALOGUE_INPUTS + 1)
        self.generation = 0
        """Number of changes."""

    def set_user(self, number: int, *, level: bool) -> None:
        """Set the wire of user input `number` to `level`; seen when it stays so for the filter's time."""
        if level == self._wire[number]:
            return
        self._wire[number] = level
        if (timer := self._pending.pop(number, None)) is not None:
            timer.cancel()
        if not self._filter_ns and not self._poll_ns:
            self._update_level(number)
        elif level != self._user[number]:
            due_ns = self._time.now_ns() + self._filter_ns
            if self._poll_ns:
                due_ns += (self._phase_ns - due_ns) % self._poll_ns
            self._pending[number] = self._time.call_at(due_ns, lambda: self._update_level(number))

    def set_volts(self, number: int, volts: float) -> None:
        """Set the voltage at analogue input `number`; 20 mV a step, 0-5.10 V (L2211-L2223)."""
        level = min(max(int(volts * _STEPS_PER_VOLT + 1e-6), 0), _FULL_SCALE)
        if level != self._analogue[number]:
            self._analogue[number] = level
            self._notify_change()

    def power_up(self) -> None:
        """Sample the wires immediately."""
        for timer in self._pending.values():
            timer.cancel()
        self._pending.clear()
        self._user = list(self._wire)

    def user_level(self, number: int) -> bool:
        return self._user[number]

    def user_pattern(self) -> int:
        """Bit value 1 = input 1, 2 = input 2, 4 = input 3."""
        return sum(1 << (number - 1) for number in range(1, USER_INPUTS + 1) if self._user[number])

    def analogue_level(self, number: int) -> int:
        """Level 0-255."""
        return self._analogue[number]

    def is_closed(self, contact: InputContact) -> bool:
        """Return whether a digital input is logic 1."""
        if contact.analogue:
            return self._analogue[contact.number] >= _LOGIC_ONE
        return self._user[contact.number]

    def is_beyond(self, threshold: AnalogueThreshold) -> bool:
        is_above = self._analogue[threshold.input] >= threshold.reference
        return is_above == threshold.above

    def is_fulfilled(self, condition: StartCondition) -> bool:
        """Return whether a level or a threshold is present."""
        if isinstance(condition, AnalogueThreshold):
            return self.is_beyond(condition)
        return self._user[condition.input] == condition.level

    def scale_level(self, scaled: ScaledInput) -> int:
        """Linear between the values at 0 V and at 5.10 V, truncated (L1984-L1986)."""
        level = self._analogue[scaled.input]
        return (scaled.at_zero * (_FULL_SCALE - level) + scaled.at_full * level) // _FULL_SCALE

    def _update_level(self, number: int) -> None:
        self._pending.pop(number, None)
        if self._user[number] != self._wire[number]:
            self._user[number] = self._wire[number]
            self._notify_change()

    def _notify_change(self) -> None:
        self.generation += 1
        self._changed()
