"""Non-volatile memory: the values that BN, BP, BV, LC and PW burn (L3239-L3325, L6735, L8441)."""

import copy

from sim.yaskawa.language.context import CommandMachine
from sim.yaskawa.motion.cam import ElectronicCam
from sim.yaskawa.motion.gearing import select_master

_SCALARS = (
    "layout",
    "position_format",
    "variable_format",
    "echo",
    "gear_master",
    "second_line",
    "unsolicited_port",
    "unsolicited_mode",
    "address",
    "retry_time",
)


class BurnedMemory:
    """The EEPROM of one controller."""

    def __init__(self, machine: CommandMachine) -> None:
        self.machine = machine
        self.erase_burned()
        self.factory = False
        """Erased since construction, so that even the option of the echo no longer applies."""

    def erase_burned(self) -> None:
        """Master reset: erase all burned values."""
        self.factory = True
        self.password = self.machine.model.password
        self.discard_parameters()
        self._program: list[str] = []
        self._cam: ElectronicCam | None = None
        self._variables: dict[str, int] = {}
        self._arrays: dict[str, list[int]] = {}

    def discard_parameters(self) -> None:
        """Discard the values burned by BN; `PW` does so (L8450)."""
        self._lock = 0
        self._registers: dict[str, dict[str, int]] = {}
        self._scalars: dict[str, object] = {}
        self._systems: dict[str, tuple[float, float, float, float]] = {}
        self._motors: dict[str, bool] = {}
        self._masters: dict[str, str] = {}
        self._polarity: list[int] | None = None
        self._outputs = 0
        self._trace = False
        self._period = 1000

    def burn_parameters(self) -> None:
        """`BN`."""
        machine = self.machine
        for axis in machine.motion.all_axes():
            self._registers[axis.name] = {name: axis.registers[name] for name in machine.model.burned}
            self._motors[axis.name] = axis.motor_off
            self._masters[axis.name] = axis.gear.source
        self._scalars = {name: getattr(machine, name) for name in _SCALARS}
        for name, system in machine.motion.systems.items():
            self._systems[name] = (system.speed, system.acceleration, system.deceleration, system.smoothing)
        self._polarity = list(machine.polarity)
        self._outputs = machine.io.outputs
        self._trace = machine.programs.trace
        self._period = machine.timebase.period_us
        self._lock = machine.locked
        if machine.model.burning.cam:
            self._burn_cam()

    def _burn_cam(self) -> None:
        self._cam = copy.deepcopy(self.machine.motion.cam)
        self._cam.disengage_all()

    def burn_period(self, period_us: int) -> None:
        """Burn only `TM`; it takes effect at once."""
        self._period = period_us
        self.machine.timebase.set_period(period_us)
        self.machine.handle_rescheduling()
        self.machine.run_ready()

    def burn_lock(self) -> None:
        """`LC` burns itself (L6741)."""
        self.burn_parameters()

    def burn_program(self) -> None:
        """`BP`: program and cam."""
        self._program = list(self.machine.program.lines)
        self._burn_cam()

    def burn_variables(self) -> None:
        """`BV`."""
        self._variables = dict(self.machine.data.variables)
        self._arrays = {name: list(array) for name, array in self.machine.data.arrays.items()}

    def restore_burned(self) -> None:
        """Power-up and `RS`: restore the burned state; `#AUTO` runs when it is burned (L15443)."""
        machine = self.machine
        self.restore_parameters()
        if self._program:
            machine.program.insert_lines(0, list(self._program))
        if self._cam is not None:
            machine.motion.cam = copy.deepcopy(self._cam)
        machine.data.variables = dict(self._variables)
        machine.data.arrays = {name: list(array) for name, array in self._arrays.items()}
        auto = machine.program.labels.get("AUTO")
        if auto is not None:
            machine.programs.threads[0].start_at(auto, 0, machine.current_sample())

    def restore_parameters(self) -> None:
        """Restore the values burned by BN."""
        machine = self.machine
        for axis in machine.motion.all_axes():
            axis.registers.update(self._registers.get(axis.name, {}))
            if not axis.virtual and not self._motors.get(axis.name, not machine.options.servo_on):
                machine.motion.switch_motor_on(axis, machine.current_sample())
            # GM is not in the list of BN (L3248-3267).
            source, axis.gear.gantry = self._masters.get(axis.name, ""), False
            if source:
                select_master(machine.motion, axis, source)
                axis.gear.set_ratio(axis.registers["GR"] / 65536, machine.current_sample())
        for name, value in self._scalars.items():
            setattr(machine, name, value)
        for name, (speed, up, down, smoothing) in self._systems.items():
            system = machine.motion.systems[name]
            system.speed, system.acceleration, system.deceleration, system.smoothing = speed, up, down, smoothing
        if self._polarity is not None:
            machine.polarity = list(self._polarity)
        machine.motion.homing.polarity = machine.polarity[1]
        machine.io.set_all(self._outputs)
        machine.programs.trace = self._trace
        if self._period != 1000:
            machine.timebase.set_period(self._period)
        machine.locked = self._lock
