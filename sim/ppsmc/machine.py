"""Axes, pulse generators, encoders and the i/o port: what commands and programs act upon."""

import random
from collections.abc import Callable
from fractions import Fraction

from orchestrator.clock.base import NS_PER_US
from sim.core.controller import LimitSwitch
from sim.core.devicetime import DeviceTime
from sim.ppsmc.axis import MOST_STEPS, NO_ERROR, Axis
from sim.ppsmc.drive import Drive
from sim.ppsmc.encoder import Encoder
from sim.ppsmc.grammar import Refused
from sim.ppsmc.options import Options
from sim.ppsmc.sensors import Switch, Switches
from sim.ppsmc.settings import Settings
from sim.ppsmc.task import Kind, Steps, Task

Finished = Callable[[bool], None]


class Machine:
    """The hardware of one unit and what its axes are doing."""

    def __init__(self, time: DeviceTime, options: Options, generator: random.Random) -> None:
        self.time = time
        self.options = options
        self.drive = Drive(time)
        self.axes = [_axis(number, options) for number in range(1, options.axes + 1)]
        self.inputs = 0
        self.on_input: Callable[[], None] | None = None
        self.on_ended: Callable[[Axis], None] | None = None
        """Told when an axis's task has ended, for verbose messages."""
        self.listeners: list[Callable[[int, bool], None]] = []
        self._outputs = 0
        self._generator = generator

    def has(self, hardware: str) -> bool:
        return hardware in self.options.hardware

    # The i/o port

    @property
    def outputs(self) -> int:
        """The output byte."""
        return self._outputs

    @outputs.setter
    def outputs(self, value: int) -> None:
        changed = self._outputs ^ value
        self._outputs = value
        for bit in range(8):
            if changed >> bit & 1:
                for listener in self.listeners:
                    listener(bit, bool(value >> bit & 1))

    def set_input(self, bit: int, level: bool) -> None:
        self.inputs = self.inputs & ~(1 << bit) | level << bit
        if self.on_input is not None:
            self.on_input()

    # Axes

    def axis(self, number: int | None) -> Axis:
        """Axis by number. Raises `Refused`."""
        if number is None:
            raise Refused("axis missing")
        if not 1 <= number <= len(self.axes):
            raise Refused(f"no axis {number}")
        return self.axes[number - 1]

    def some(self, number: int | None) -> list[Axis]:
        """One axis, or all. Raises `Refused`."""
        return list(self.axes) if number is None else [self.axis(number)]

    @property
    def still(self) -> bool:
        """Whether no axis does anything."""
        return all(axis.task is None for axis in self.axes)

    def limit_on(self, axis: Axis, switch: Switch) -> bool:
        """Whether a switch of the axis is on, now."""
        return axis.switches.on(switch, self.drive.counter(axis) - axis.origin)

    @property
    def any_limit(self) -> bool:
        """Whether any limit switch of any axis is active."""
        return any(self.limit_on(axis, switch) for axis in self.axes for switch in (Switch.EL_MINUS, Switch.EL_PLUS))

    def measured(self, axis: Axis) -> Fraction:
        """Encoder position in the axis's unit; of two encoders the average (L4571)."""
        here = axis.encoder_distance(self.drive.exact(axis)[0])
        if not axis.settings.twen:
            return here
        twin = self.axes[axis.settings.twen - 1]
        return (here + twin.encoder_distance(self.drive.exact(twin)[0])) / 2

    def start_ns(self) -> int | None:
        """When one axis of a group starts: now, or a little later (decision 12)."""
        skew_ns = self.options.start_skew_us * NS_PER_US
        return self.time.now_ns() + round(self._generator.uniform(0.0, skew_ns)) if skew_ns else None

    def check_input(self, axis: Axis) -> None:
        """Raises `Refused` when the input port does not allow the axis to move (L614)."""
        if axis.settings.emips not in (-1, self.inputs):
            raise Refused(f"axis {axis.number}: input port is {self.inputs}, not {axis.settings.emips}")

    @staticmethod
    def check_target(steps: int) -> None:
        """Raises `Refused` for targets out of the counter's range (L2022)."""
        if abs(steps) > MOST_STEPS:
            raise Refused("target out of range")

    def launch(self, axis: Axis, kind: Kind, steps: Steps, finished: Finished | None = None) -> None:
        """Begin a task of an axis that does nothing. Raises `Refused` when the input port forbids it."""
        self.check_input(axis)

        def over(task: Task, by_itself: bool) -> None:
            queued, task.axis.queued = task.axis.queued, None
            if finished is not None:
                finished(by_itself)
            if self.on_ended is not None:
                self.on_ended(task.axis)
            if queued is not None and by_itself:
                queued()

        Task(self.drive, axis, kind, steps, over, self.options.limit_clears_reference).begin()

    def stop(self, axis: Axis) -> None:
        """q of one axis: a decelerated stop, and no target waits any longer."""
        axis.queued = None
        if axis.task is not None:
            axis.task.stop()

    def halt(self) -> None:
        """Everything stops dead."""
        for axis in self.axes:
            axis.queued = None
            if axis.task is not None:
                axis.task.abort()

    def power_up(self) -> None:
        """Volatile state of the axes as after power-up; the stage stays where it is."""
        for axis in self.axes:
            axis.set_counter(0)
            axis.referenced = axis.index_found = axis.homed = axis.oscillation_error = False
            axis.error = NO_ERROR
            axis.target = None
        self.outputs = 0

    # The world

    def set_limit(self, axis: Axis, which: LimitSwitch) -> None:
        """Hold both limit switches of an axis, or let go of them."""
        for switch, pressing in ((Switch.EL_PLUS, ("forward", "both")), (Switch.EL_MINUS, ("reverse", "both"))):
            if which == "none":
                axis.switches.held.pop(switch, None)
            else:
                axis.switches.held[switch] = which in pressing
        self.rearm(axis)

    def rearm(self, axis: Axis) -> None:
        """A switch has changed."""
        if axis.run is not None:
            self.drive.arm(axis.run)

    def set_stalled(self, axis: Axis, stalled: bool) -> None:
        """A stalled stage does not follow its motor; only its encoder can tell."""
        if axis.encoder is not None:
            place = self.drive.exact(axis)[0] - axis.origin
            if stalled:
                axis.encoder.stall(place)
            else:
                axis.encoder.release(place)


def _axis(number: int, options: Options) -> Axis:
    key = str(number)
    switches = Switches()
    if key in options.travel_steps:
        low, high = options.travel_steps[key]
        switches.zones[Switch.EL_MINUS] = (-float("inf"), low)
        switches.zones[Switch.EL_PLUS] = (high, float("inf"))
    for switch, zones in (
        (Switch.ORG, options.org_steps),
        (Switch.SD, options.sd_steps),
        (Switch.INDEX, options.index_steps),
    ):
        if key in zones:
            switches.zones[switch] = zones[key]
    per_step = options.increments_per_step if options.encoder_follows else None
    encoder = Encoder(per_step) if options.encoder else None
    return Axis(number, Settings(dcpl=options.dcpl), switches, encoder)
