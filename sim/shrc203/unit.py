"""The whole unit: what every command works on."""

from collections.abc import Sequence
from enum import Enum, auto
from fractions import Fraction

from sim.core.devicetime import DeviceTime
from sim.shrc203.axis import Axis
from sim.shrc203.chain import Chain
from sim.shrc203.drive import Cause, Drive
from sim.shrc203.grammar import GROUPS, Refused
from sim.shrc203.inputs import Inputs, Outputs
from sim.shrc203.line import Reply
from sim.shrc203.options import Options
from sim.shrc203.program_lines import Programs
from sim.shrc203.program_run import ProgramRun
from sim.shrc203.registration import Registrations
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
    Switches,
)
from sim.shrc203.trigger import Trigger

MODEL = "SHRC-203"
_MOVABLE = frozenset(("S6",))


class Area(Enum):
    """Which commands are usable (decision 45)."""

    HOST = auto()
    PANEL = auto()
    """MANUAL, REMOTE, TEACHING, EDIT, LOAD, TEST."""
    PROGRAM = auto()
    PROGRAM_EDIT = auto()
    SWITCHES = auto()


class Unit:
    """Axes, settings, and the parts that make them move."""

    def __init__(self, time: DeviceTime, options: Options, scan_phase_ns: int) -> None:
        self.time = time
        self.options = options
        self.switches = Switches(options)
        self.axes = [Axis(index, str(index + 1)) for index in range(3)]
        self.inputs = Inputs(time, scan_phase_ns)
        self.outputs = Outputs()
        self.drive = Drive(time, options)
        self.chain = Chain(self.axes, time, self.drive, self.inputs, options)
        self.registrations = Registrations()
        self.programs = Programs()
        self.trigger = Trigger(time, self.drive, options.scale_resolution_nm)
        self.program = ProgramRun(self.axes, time, self.drive, self.inputs, self.outputs, self.trigger, self)
        self.controllable: list[Axis] = []
        self.mode = "HOST"
        self.area = Area.HOST
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
        self.addressed: Sequence[Axis] | None = None
        """The axes that the command being executed has named."""
        for axis in self.axes:
            self._fit_stage(axis)
        self.power_up()

    # Power

    def _fit_stage(self, axis: Axis) -> None:
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
        """Volatile state from the memory switches (section 14); the stages stay where they are."""
        switches = self.switches
        numbers = switches.controllable()
        for axis in self.axes:
            index = axis.index
            axis.controllable = index + 1 in numbers
            axis.offset, axis.zeroed, axis.slip = -axis.position, 0, 0
            axis.base_rate = int(switches.axis(A_BASE_RATE, index))
            axis.divide = switches.divide(index)
            axis.axis_name = switches.axis(A_NAME, index)
            axis.stage_unit = STAGE_UNITS[int(switches.axis(A_UNIT, index))]
            found = self.options.config[index]
            on = switches.axis(A_CONFIG, index) == "1"
            axis.config = (found if found != "off" else CONFIGS[-1]) if on else "off"
            axis.triple = switches.power_up_speed(index)
            axis.origin_triple = switches.origin_speed(index)
            axis.closed_loop = self.options.scales and switches.closed_loop(index)
            axis.soft_limits = switches.soft_limits(index)
            axis.excited = True
            axis.errors.clear()
            axis.check_limits()
            axis.command_error, axis.limit_stop, axis.soft_stop = False, False, 0
        self.controllable = [axis for axis in self.axes if axis.controllable]
        self.mode = "MANUAL" if switches.general(G_MODE) else "HOST"
        self.area = Area.PANEL if switches.general(G_MODE) else Area.HOST
        self.format = "HIT" if switches.general(G_FORMAT) else "SHOT_FC"
        self.beep = bool(switches.general(G_BEEP))
        self.sleeping, self.display = False, True
        self.command_error, self.previous = False, ""
        self.restart_due = False

    def power_down(self) -> None:
        """Motion stops dead, what is volatile is forgotten, outputs go off."""
        self.program.clear()
        for axis in self.axes:
            self.chain.clear(axis)
        self.trigger.clear()
        self.drive.wait_tenths = 0
        self.outputs.set(0)
        self.registrations.forget_positions()
        self.programs.power_down()

    # Checks that commands share

    def group(self, letter: str) -> list[Axis]:
        """The axes of an axis letter; W or nothing: all controllable ones. An invalid axis refuses the command."""
        if letter in ("", "W"):
            axes = self.controllable
        elif letter in GROUPS:
            axes = [self.axes[index] for index in GROUPS[letter]]
        else:
            raise Refused
        self.addressed = axes
        if not all(axis.controllable for axis in axes):
            raise Refused
        return axes

    def need_ready(self, axes: Sequence[Axis] | None = None) -> None:
        """Refuse while one of the axes is Busy; without axes, any controllable one (decision 7)."""
        if axes is None or self.options.busy_anywhere:
            axes = self.controllable
        if any(axis.busy for axis in axes):
            raise Refused

    def need_power(self, axes: Sequence[Axis]) -> None:
        """Refuse with the excitation off, which it also is in sleep."""
        if self.sleeping or not all(axis.excited for axis in axes):
            raise Refused

    def need_sound(self, axes: Sequence[Axis]) -> None:
        """Refuse motion with the excitation off or an error standing (decision 27).

        A counter overflow does not count: it takes a motion, or a new coordinate, to get out of it.
        """
        self.need_power(axes)
        if any(axis.errors - _MOVABLE for axis in axes):
            raise Refused

    def need_no_limit(self, axes: Sequence[Axis]) -> None:
        """Refuse while a limit sensor of one of the axes is on (L3423)."""
        for axis in axes:
            if axis.limit_on(1, axis.position) or axis.limit_on(-1, axis.position):
                raise Refused

    # What concerns the whole unit

    def coordinate(self, axis: Axis, at_ns: int) -> int:
        """The command counter, pls."""
        return self.drive.position(axis, at_ns) + axis.offset

    def scale_coordinate(self, axis: Axis, at_ns: int) -> int:
        """The scale counter, in pulses; 0 without a scale."""
        return self.drive.followed(axis, at_ns) + axis.offset if self.options.scales else 0

    def ready_to_run(self, axis: Axis) -> bool:
        """Whether a program may move the axis."""
        return axis.excited and not axis.errors - _MOVABLE and not self.sleeping

    def emergency_stop(self) -> None:
        """L:E: everything stops at once (L2990)."""
        self.program.fail()
        for axis in self.axes:
            self.chain.abort(axis, Cause.ERROR)
        for axis in self.controllable:
            axis.errors.add("EMERGENCY")
            if self.switches.axis(A_EMERGENCY, axis.index) == "0":
                axis.excited = False

    def start_reporting(self, reply: Reply) -> None:
        """COMP and TRIG lines go to the port that started the program (decision 47)."""
        self.program.reply = reply
