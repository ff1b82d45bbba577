"""What starts the automatic routines: limits, errors, inputs, lost connections (L14325-L14369, L15443-L15613)."""

from typing import TYPE_CHECKING

from sim.yaskawa.base import fixed
from sim.yaskawa.motion.axis import Axis

if TYPE_CHECKING:
    from sim.yaskawa.machine import Machine


class Events:
    """Watches for the conditions of #LIMSWI, #POSERR and #ININT; all of them need thread 0 to run."""

    def __init__(self, machine: "Machine") -> None:
        self.machine = machine
        self.limit_met = False
        self.error_met = False
        """An amplifier has gone off because of its error, which is told although the servo is off by now."""

    def met_limit(self) -> None:
        """A moving axis has met a limit."""
        self.limit_met = self.machine.interpreter.threads[0].running

    def met_error(self) -> None:
        """Off-on-error has acted (L8029)."""
        self.error_met = self.machine.interpreter.threads[0].running

    @property
    def watched(self) -> bool:
        """Whether there is a routine for a condition that `poll` would find."""
        return not self.machine.program.labels.keys().isdisjoint(("LIMSWI", "POSERR"))

    def poll(self) -> None:
        """Between two lines, and in every event: start a routine whose condition holds."""
        machine = self.machine
        if not machine.interpreter.threads[0].running:
            return
        now = machine.now()
        labels = machine.program.labels
        if "LIMSWI" in labels and self.limit_met:
            if self._limit_stands(now):
                machine.interpreter.raise_event("LIMSWI")
            elif machine.interpreter.raise_event("LIMSWI"):
                self.limit_met = False
        wanted = "POSERR" in labels and (self.error_met or self._error_stands(now))
        if wanted and machine.interpreter.raise_event("POSERR"):
            self.error_met = False

    def _limit_stands(self, now: int) -> bool:
        motion = self.machine.motion
        return any(motion.limit_active(axis, side, now) for axis in motion.real for side in (True, False))

    def _error_stands(self, now: int) -> bool:
        return any(self.beyond(axis, axis.error(now)) for axis in self.machine.motion.real if axis.frozen is not None)

    def beyond(self, axis: Axis, error: int) -> bool:
        """Whether a position error is beyond ER, for a servo that is on (L4962)."""
        limit = fixed.truncated(axis.registers["ER"])
        return bool(limit) and not axis.virtual and not axis.motor_off and abs(error) > limit

    def inputs_changed(self, number: int, level: bool) -> None:
        """An input that is enabled by II has come to its active level (L5952)."""
        interpreter = self.machine.interpreter
        if not interpreter.interrupts_on:
            return
        bit = 1 << (number - 1)
        active = bool(interpreter.active_high & bit)
        if interpreter.interrupts & bit and level == active and interpreter.raise_event("ININT"):
            interpreter.interrupts_on = False
