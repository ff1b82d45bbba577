"""The mechanics behind the motors of a simulated controller: play, and errors of position, with a truth of their own.

A motor moves its axis through a drive with play, which a motion takes up after each reversal, and a screw whose pitch
is not even. Axes may also move each other: a guide that is not straight. No part of a fleet sees this; tests read it.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from orchestrator.model.fleet import AxisMechanics, Controller
from sim.core.controller import SimulatedController


class Mechanics:
    """The axes of one controller. Motions in one direction are followed whenever it looks; one that turns back on its
    way, as a path does, must be looked at on the way."""

    def __init__(
        self, controller: SimulatedController, config: Controller, others: Mapping[str, "Mechanics"] | None = None
    ) -> None:
        """others: by controller, those whose axes move axes of this one."""
        self._others: Mapping[str, Mechanics] = {} if others is None else others
        self._controller = controller
        self._config = config
        self._slack = dict.fromkeys(config.axes, 0.0)
        """How far an axis is ahead of its motor, in its unit, from 0 to its play."""
        self._followed = dict.fromkeys(config.axes, 0)
        """Motions that are followed to their ends, of all axes of the controller."""
        self._part_counts = dict.fromkeys(config.axes, 0.0)
        """Of the motion that runs: how far it is followed."""

    def look(self) -> None:
        """Follow the motors to where they are now."""
        for name in self._config.axes:
            self._follow_axis(name)

    def position(self, name: str) -> float:
        """Where an axis is now, in its unit, from its reference."""
        self.look()
        return self._find_motor(name) + self._slack[name] + self._find_error(name)

    def _follow_axis(self, name: str) -> None:
        motor, motions = self._config.axes[name].motors[0], self._controller.commanded_motions
        for motion in motions[self._followed[name] :]:
            end_counts = motion.end_counts
            if motion.axis == motor:
                reached_counts = self._controller.position(motor) if end_counts is None else end_counts
                self._turn(name, reached_counts - motion.start_counts - self._part_counts[name])
                self._part_counts[name] = 0.0 if end_counts is not None else reached_counts - motion.start_counts
                if end_counts is None:
                    return
            self._followed[name] += 1

    def _turn(self, name: str, counts: float) -> None:
        by = counts / float(self._config.axes[name].counts_per_unit)
        self._slack[name] = min(max(self._slack[name] - by, 0.0), self._settings(name).backlash)

    def _find_motor(self, name: str) -> float:
        axis = self._config.axes[name]
        return self._controller.position(axis.motors[0]) / float(axis.counts_per_unit)

    def _find_error(self, name: str) -> float:
        settings = self._settings(name)
        tables = {name: settings.errors, **settings.errors_of} if settings.errors else settings.errors_of
        return sum(interpolate(rows, self._find_motor_of(of)) for of, rows in tables.items())

    def _find_motor_of(self, name: str) -> float:
        """Where the motor is that moves an axis: of `axis`, or of `controller.axis`."""
        owner, _, axis = name.rpartition(".")
        return self._others[owner]._find_motor(axis) if owner else self._find_motor(axis)  # noqa: SLF001

    def _settings(self, name: str) -> AxisMechanics:
        return self._config.simulate.mechanics.get(name, _RIGID)


_RIGID = AxisMechanics()


def interpolate(rows: Sequence[Sequence[float]], position: float) -> float:
    """The error at a position: straight between rows, and as at the ends beyond them."""
    return float(np.interp(position, [row[0] for row in rows], [row[1] for row in rows]))
