"""Axes, pulse generators, encoders and the i/o port: the hardware that commands and programs act on."""

import random
from collections.abc import Callable
from fractions import Fraction

from orchestrator.clock.base import NS_PER_US
from sim.core.controller import LimitSwitch
from sim.core.devicetime import DeviceTime
from sim.ppsmc.axis import NO_ERROR, STEP_LIMIT, StepperAxis
from sim.ppsmc.drive import PulseGenerator
from sim.ppsmc.encoder import IncrementalEncoder
from sim.ppsmc.grammar import InputRefused
from sim.ppsmc.legs import Steps, TaskKind
from sim.ppsmc.options import PpsmcOptions
from sim.ppsmc.sensors import TravelSwitch, TravelSwitches
from sim.ppsmc.settings import AxisSettings
from sim.ppsmc.task import AxisTask

Finished = Callable[[], None]


class StepperHardware:
    """The hardware of one controller and the activity of its axes."""

    def __init__(self, time: DeviceTime, options: PpsmcOptions, generator: random.Random) -> None:
        self.time = time
        self.options = options
        self.drive = PulseGenerator(time, options.limit_clears_reference)
        self.axes = [_build_axis(number, options) for number in range(1, options.axes + 1)]
        self.inputs = 0
        self.on_input: Callable[[], None] | None = None
        self.on_ended: Callable[[StepperAxis], None] | None = None
        """Called when an axis's task has ended, for verbose messages."""
        self.listeners: list[Callable[[int, bool], None]] = []
        self._outputs = 0
        self._generator = generator

    def has_hardware(self, hardware: str) -> bool:
        return hardware in self.options.hardware

    # The i/o port

    @property
    def output_byte(self) -> int:
        """The output byte."""
        return self._outputs

    @output_byte.setter
    def output_byte(self, value: int) -> None:
        changed_outputs = self._outputs ^ value
        self._outputs = value
        for bit in range(8):
            if changed_outputs >> bit & 1:
                for listener in self.listeners:
                    listener(bit, bool(value >> bit & 1))

    def set_input(self, bit: int, *, level: bool) -> None:
        self.inputs = self.inputs & ~(1 << bit) | level << bit
        if self.on_input is not None:
            self.on_input()

    # Axes

    def find_axis(self, number: int | None) -> StepperAxis:
        """Return an axis by number. Raises `InputRefused`."""
        if number is None:
            raise InputRefused("axis missing")
        if not 1 <= number <= len(self.axes):
            raise InputRefused(f"no axis {number}")
        return self.axes[number - 1]

    def select_axes(self, number: int | None) -> list[StepperAxis]:
        """Return one axis, or all. Raises `InputRefused`."""
        return list(self.axes) if number is None else [self.find_axis(number)]

    @property
    def is_still(self) -> bool:
        """Return whether no axis is active."""
        return all(axis.task is None for axis in self.axes)

    def is_limit_on(self, axis: StepperAxis, switch: TravelSwitch) -> bool:
        """Return whether a switch of the axis is on, now."""
        return axis.switches.is_on(switch, self.drive.step_counter(axis) - axis.origin)

    @property
    def is_any_limit_on(self) -> bool:
        """Return whether any limit switch of any axis is active."""
        return any(
            self.is_limit_on(axis, switch)
            for axis in self.axes
            for switch in (TravelSwitch.EL_MINUS, TravelSwitch.EL_PLUS)
        )

    def measured_position(self, axis: StepperAxis) -> Fraction:
        """Return the encoder position in the axis's unit; of two encoders the average (L4571)."""
        steps = axis.encoder_distance(self.drive.exact_state(axis)[0])
        if not axis.settings.twen:
            return steps
        twin = self.axes[axis.settings.twen - 1]
        return (steps + twin.encoder_distance(self.drive.exact_state(twin)[0])) / 2

    def group_start_ns(self) -> int | None:
        """Return the start time of one axis of a group: now, or slightly later (decision 12)."""
        skew_ns = self.options.start_skew_us * NS_PER_US
        return self.time.now_ns() + round(self._generator.uniform(0.0, skew_ns)) if skew_ns else None

    def check_input(self, axis: StepperAxis) -> None:
        """Raise `InputRefused` when the input port does not allow the axis to move (L614)."""
        if axis.settings.emips not in (-1, self.inputs):
            raise InputRefused(f"axis {axis.number}: input port is {self.inputs}, not {axis.settings.emips}")

    @staticmethod
    def check_target(steps: int) -> None:
        """Raise `InputRefused` for targets out of the counter's range (L2022)."""
        if abs(steps) > STEP_LIMIT:
            raise InputRefused("target out of range")

    def launch_task(self, axis: StepperAxis, kind: TaskKind, steps: Steps, finished: Finished | None = None) -> None:
        """Begin a task of an idle axis. Raises `InputRefused` when the input port forbids it."""
        self.check_input(axis)

        def handle_task_end(task: AxisTask, *, by_itself: bool) -> None:
            next_task, task.axis.queued = task.axis.queued, None
            if finished is not None:
                finished()
            if self.on_ended is not None:
                self.on_ended(task.axis)
            if next_task is not None and by_itself:
                next_task()

        AxisTask(
            self.drive,
            axis,
            kind,
            steps,
            lambda task, by_itself: handle_task_end(task, by_itself=by_itself),
        ).begin_task()

    def stop_axis(self, axis: StepperAxis) -> None:
        """q of one axis: stop with deceleration and discard a waiting target."""
        axis.queued = None
        if axis.task is not None:
            axis.task.stop_task()

    def halt_axes(self) -> None:
        """Stop everything dead."""
        for axis in self.axes:
            axis.queued = None
            if axis.task is not None:
                axis.task.abort_task()

    def power_up(self) -> None:
        """Reset the volatile state of the axes to its power-up state; the stage keeps its position."""
        for axis in self.axes:
            axis.set_counter(0)
            axis.referenced = axis.index_found = axis.homed = axis.oscillation_error = False
            axis.error = NO_ERROR
            axis.target = None
        self.output_byte = 0

    # Environment

    def set_limit(self, axis: StepperAxis, which: LimitSwitch) -> None:
        """Press both limit switches of an axis, or restore them."""
        for switch, pressing in (
            (TravelSwitch.EL_PLUS, ("forward", "both")),
            (TravelSwitch.EL_MINUS, ("reverse", "both")),
        ):
            if which == "none":
                axis.switches.held.pop(switch, None)
            else:
                axis.switches.held[switch] = which in pressing
        self.rearm_axis(axis)

    def rearm_axis(self, axis: StepperAxis) -> None:
        """Handle a change of a switch."""
        if axis.run is not None:
            self.drive.arm_run(axis.run)

    def set_stalled(self, axis: StepperAxis, *, stalled: bool) -> None:
        """Stall or free a stage. A stalled stage does not follow its motor; only its encoder detects it."""
        if axis.encoder is not None:
            position = self.drive.exact_state(axis)[0] - axis.origin
            if stalled:
                axis.encoder.stall_stage(position)
            else:
                axis.encoder.free_stage(position)


def _build_axis(number: int, options: PpsmcOptions) -> StepperAxis:
    key = str(number)
    switches = TravelSwitches()
    if key in options.travel_steps:
        low, high = options.travel_steps[key]
        switches.zones[TravelSwitch.EL_MINUS] = (-float("inf"), low)
        switches.zones[TravelSwitch.EL_PLUS] = (high, float("inf"))
    for switch, zones in (
        (TravelSwitch.ORG, options.org_steps),
        (TravelSwitch.SD, options.sd_steps),
        (TravelSwitch.INDEX, options.index_steps),
    ):
        if key in zones:
            switches.zones[switch] = zones[key]
    per_step = options.increments_per_step if options.encoder_follows else None
    encoder = IncrementalEncoder(per_step) if options.encoder else None
    numerator, denominator = options.gears.get(str(number), (1, 1))
    settings = AxisSettings(dcpl=options.dcpl, gnum=Fraction(numerator), gden=Fraction(denominator))
    return StepperAxis(number, settings, switches, encoder)
