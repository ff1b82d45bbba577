"""The mechanics behind the motors of a simulated controller: play, and errors of position, with a truth of their own.

A motor moves its axis through a drive with play, which a motion takes up after each reversal, and a screw whose pitch is
not even. Axes may also move each other: a guide that is not straight. No part of a fleet sees this; tests read it.
"""

from collections.abc import Sequence

import numpy as np

from orchestrator.model.fleet import AxisMechanics, Controller
from sim.core.controller import SimulatedController


class Mechanics:
    """The axes of one controller. It sees the motors only when it is told to look: between two looks a motor must not
    have turned back."""

    def __init__(self, controller: SimulatedController, config: Controller) -> None:
        self._controller = controller
        self._config = config
        self._slack: dict[str, float] = {}
        """By axis, in its unit: how far it is ahead of its motor, from 0 to its play."""
        self._seen: dict[str, float] = {}
        self.look()

    def look(self) -> None:
        """Follow the motors to where they are now."""
        for name, axis in self._config.axes.items():
            motor = self._controller.physical_position(axis.motors[0]) / float(axis.counts_per_unit)
            by = motor - self._seen.setdefault(name, motor)
            self._slack[name] = min(max(self._slack.get(name, 0.0) - by, 0.0), self._settings(name).backlash)
            self._seen[name] = motor

    def position(self, name: str) -> float:
        """Where an axis is now, in its unit, from its reference."""
        self.look()
        return self._turned(name) + self._slack[name] + self._error(name)

    def _turned(self, name: str) -> float:
        axis = self._config.axes[name]
        return self._controller.position(axis.motors[0]) / float(axis.counts_per_unit)

    def _error(self, name: str) -> float:
        settings = self._settings(name)
        tables = {name: settings.errors, **settings.errors_of} if settings.errors else settings.errors_of
        return sum(_interpolate(rows, self._turned(of)) for of, rows in tables.items())

    def _settings(self, name: str) -> AxisMechanics:
        return self._config.simulate.mechanics.get(name, _RIGID)


_RIGID = AxisMechanics()


def _interpolate(rows: Sequence[Sequence[float]], position: float) -> float:
    """The error at a position: straight between rows, and as at the ends beyond them."""
    return float(np.interp(position, *zip(*rows, strict=True)))
