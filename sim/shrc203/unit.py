"""The whole controller: the state that every command works on."""

from collections.abc import Sequence
from enum import Enum, auto
from fractions import Fraction

from sim.core.devicetime import DeviceTime
from sim.shrc203.axis import EndCause, StageAxis
from sim.shrc203.chain import DoubleBuffer
from sim.shrc203.drive import PathGenerator
from sim.shrc203.grammar import GROUPS, CommandRefused
from sim.shrc203.inputs import InputScanner, OutputLevels
from sim.shrc203.line import Reply
from sim.shrc203.options import Shrc203Options
from sim.shrc203.program_lines import StoredPrograms
from sim.shrc203.program_run import ProgramRun
from sim.shrc203.registration import PositionRecords
from sim.shrc203.switches import (
    A_BASE_RATE,
    A_CONFIG,
    A_EMERGENCY,
    A_NAME,
    A_UNIT,
    CONFIGS,
    G_BEEP,
    G_FORMAT,
    G_MODE,
    STAGE_UNITS,
    MemorySwitches,
)
from sim.shrc203.trigger import TriggerOutput

MODEL = "SHRC-203"
_MOVABLE = frozenset(("S6",))


class CommandArea(Enum):
    """Area in which a command is usable (decision 45)."""

    HOST = auto()
    PANEL = auto()
    """MANUAL, REMOTE, TEACHING, EDIT, LOAD, TEST."""
    PROGRAM = auto()
    PROGRAM_EDIT = auto()
    SWITCHES = auto()


class StageSystem:
    """Axes, settings, and the parts that move them."""

    def __init__(self, time: DeviceTime, options: Shrc203Options, scan_phase_ns: int) -> None:
        self.time = time
        self.options = options
        self.switches = MemorySwitches(options)
        self.axes = [StageAxis(index, str(index + 1)) for index in range(3)]
        self.inputs = InputScanner(time, scan_phase_ns)
        self.outputs = OutputLevels()
        self.drive = PathGenerator(time, options)
        self.chain = DoubleBuffer(self.axes, time, self.drive, self.inputs, options)
        self.registrations = PositionRecords()
        self.programs = StoredPrograms()
        self.trigger = TriggerOutput(time, self.drive, options.scale_resolution_nm)
        self.program = ProgramRun(self)
        self.controllable: list[StageAxis] = []
        self.mode = "HOST"
        self.area = CommandArea.HOST
        self.format = "SHOT_FC"
        self.sleeping = False
        self.display = True
        self.beep = True
        self.command_error = False
        """Decision 16: a setting command was refused, and none has been accepted since."""
        self.previous = ""
        """The last line received, for ?:CMD."""
        self.restart_due = False
        """A changed memory switch makes the unit restart by itself (L7712)."""
        self.addressed: Sequence[StageAxis] | None = None
        """The axes that the command being executed has named."""
        for axis in self.axes:
            self._fit_stage(axis)
        self.power_up()

    # Power

    def _fit_stage(self, axis: StageAxis) -> None:
        options = self.options
        for key, origin in options.origin_pls.items():
            if key == axis.name:
                axis.origin = origin
        for key, degrees in options.deg_per_pulse.items():
            if key == axis.name:
                axis.deg_per_pulse = Fraction(str(degrees))
        for key, travel in options.travel_pls.items():
            if key == axis.name:
                axis.travel = travel

    def power_up(self) -> None:
        """Set volatile state from the memory switches (section 14); the stages keep their positions."""
        switches = self.switches
        numbers = switches.controllable_axes()
        for axis in self.axes:
            index = axis.index
            axis.controllable = index + 1 in numbers
            axis.offset, axis.zeroed, axis.scale_deviation = -axis.position, 0, 0
            axis.base_rate = int(switches.axis_content(A_BASE_RATE, index))
            axis.divide = switches.division_number(index)
            axis.axis_name = switches.axis_content(A_NAME, index)
            axis.stage_unit = STAGE_UNITS[int(switches.axis_content(A_UNIT, index))]
            config = self.options.config[index]
            on = switches.axis_content(A_CONFIG, index) == "1"
            axis.config = (config if config != "off" else CONFIGS[-1]) if on else "off"
            axis.triple = switches.power_up_speed(index)
            axis.origin_triple = switches.origin_speed(index)
            axis.closed_loop = self.options.scales and switches.closed_loop(index)
            axis.soft_limits = switches.soft_limits(index)
            axis.excited = True
            axis.errors.clear()
            axis.check_limits()
            axis.command_error, axis.limit_stop, axis.soft_stop = False, False, 0
        self.controllable = [axis for axis in self.axes if axis.controllable]
        self.mode = "MANUAL" if switches.general_value(G_MODE) else "HOST"
        self.area = CommandArea.PANEL if switches.general_value(G_MODE) else CommandArea.HOST
        self.format = "HIT" if switches.general_value(G_FORMAT) else "SHOT_FC"
        self.beep = bool(switches.general_value(G_BEEP))
        self.sleeping, self.display = False, True
        self.command_error, self.previous = False, ""
        self.restart_due = False

    def power_down(self) -> None:
        """Stop dead, clear the volatile state, switch the outputs off."""
        self.program.clear_run()
        for axis in self.axes:
            self.chain.clear_axis(axis)
        self.trigger.clear_trigger()
        self.drive.wait_tenths = 0
        self.outputs.set_levels(0)
        self.registrations.forget_positions()
        self.programs.power_down()

    # Checks that commands share

    def resolve_axes(self, letter: str) -> list[StageAxis]:
        """Return the axes of a letter; W or nothing: all controllable ones. An invalid axis refuses the command."""
        if letter in ("", "W"):
            axes = self.controllable
        elif letter in GROUPS:
            axes = [self.axes[index] for index in GROUPS[letter]]
        else:
            raise CommandRefused
        self.addressed = axes
        if not all(axis.controllable for axis in axes):
            raise CommandRefused
        return axes

    def require_ready(self, axes: Sequence[StageAxis] | None = None) -> None:
        """Refuse while one of the axes is Busy; without axes, any controllable one (decision 7)."""
        if axes is None or self.options.busy_anywhere:
            axes = self.controllable
        if any(axis.is_busy for axis in axes):
            raise CommandRefused

    def require_power(self, axes: Sequence[StageAxis]) -> None:
        """Refuse with the excitation off, which it also is in sleep."""
        if self.sleeping or not all(axis.excited for axis in axes):
            raise CommandRefused

    def require_error_free(self, axes: Sequence[StageAxis]) -> None:
        """Refuse motion with the excitation off or an active error (decision 27).

        A counter overflow does not count: leaving it takes a motion, or a new coordinate.
        """
        self.require_power(axes)
        if any(axis.errors - _MOVABLE for axis in axes):
            raise CommandRefused

    def require_no_limit(self, axes: Sequence[StageAxis]) -> None:
        """Refuse while a limit sensor of one of the axes is on (L3423)."""
        for axis in axes:
            if axis.limit_on(1, axis.position) or axis.limit_on(-1, axis.position):
                raise CommandRefused

    # State of the whole controller

    def command_coordinate(self, axis: StageAxis, at_ns: int) -> int:
        """The command counter, pls."""
        return self.drive.output_position(axis, at_ns) + axis.offset

    def scale_coordinate(self, axis: StageAxis, at_ns: int) -> int:
        """The scale counter, in pulses; 0 without a scale."""
        return self.drive.scale_position(axis, at_ns) + axis.offset if self.options.scales else 0

    def ready_to_run(self, axis: StageAxis) -> bool:
        """Return whether a program may move the axis."""
        return axis.excited and not axis.errors - _MOVABLE and not self.sleeping

    def emergency_stop(self) -> None:
        """L:E: stop everything immediately (L2990)."""
        self.program.fail_program()
        for axis in self.axes:
            self.chain.abort_axis(axis, EndCause.ERROR)
        for axis in self.controllable:
            axis.errors.add("EMERGENCY")
            if self.switches.axis_content(A_EMERGENCY, axis.index) == "0":
                axis.excited = False

    def start_reporting(self, reply: Reply) -> None:
        """Send COMP and TRIG lines to the port that started the program (decision 47)."""
        self.program.reply = reply
