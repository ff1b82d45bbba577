"""Start of the automatic routines: limits, errors, inputs, lost connections (L14325-L14369, L15443-L15613)."""

from sim.yaskawa.language.context import CommandMachine


class AutomaticEvents:
    """Watches the conditions of #LIMSWI, #POSERR and #ININT; all of them need thread 0 to run."""

    def __init__(self, machine: CommandMachine) -> None:
        self.machine = machine
        self.limit_reached = False
        self.error_reached = False
        """An amplifier has switched off because of its error, which is reported although the servo is off by now."""

    def handle_limit(self) -> None:
        """Handle a moving axis that reaches a limit."""
        self.limit_reached = self.machine.programs.threads[0].running

    def handle_error(self) -> None:
        """Handle an off-on-error (L8029)."""
        self.error_reached = self.machine.programs.threads[0].running

    @property
    def has_routines(self) -> bool:
        """Return whether there is a routine for a condition that `start_due_routines` could find."""
        return not self.machine.program.labels.keys().isdisjoint(("LIMSWI", "POSERR"))

    def start_due_routines(self) -> None:
        """Start a routine whose condition holds; called between two lines, and in every event."""
        machine = self.machine
        if not machine.programs.threads[0].running:
            return
        sample_now = machine.current_sample()
        labels = machine.program.labels
        if "LIMSWI" in labels and self.limit_reached:
            if self._is_limit_active(sample_now):
                machine.programs.raise_event("LIMSWI")
            elif machine.programs.raise_event("LIMSWI"):
                self.limit_reached = False
        has_handler = "POSERR" in labels and (self.error_reached or self._is_error_active(sample_now))
        if has_handler and machine.programs.raise_event("POSERR"):
            self.error_reached = False

    def _is_limit_active(self, now: int) -> bool:
        motion = self.machine.motion
        return any(
            motion.limits.limit_active(axis, forward=side, now=now) for axis in motion.real for side in (True, False)
        )

    def _is_error_active(self, now: int) -> bool:
        return any(
            axis.exceeds_error_limit(axis.position_error(now))
            for axis in self.machine.motion.real
            if axis.frozen is not None
        )

    def inputs_changed(self, number: int, *, level: bool) -> None:
        """Handle an input that is enabled by II and becomes active (L5952)."""
        programs = self.machine.programs
        if not programs.interrupts_on:
            return
        bit = 1 << (number - 1)
        active = bool(programs.active_high & bit)
        if programs.interrupts & bit and level == active and programs.raise_event("ININT"):
            programs.interrupts_on = False
