"""Paths in the fault campaign: while they are executed, their axes are on them."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orchestrator.campaign.records import CampaignPhase
from orchestrator.model.names import controller_of
from orchestrator.model.paths.pieces import LinePiece, Within
from orchestrator.model.steps.path import FollowPath
from orchestrator.runtime.virtual.fleet import VirtualFleet

Array = NDArray[np.float64]


class PathChecker:
    """Checks the true positions of axes against the path that their job moves them along: lines."""

    def __init__(self, fleet: VirtualFleet, add_violation: Callable[[str, str], None]) -> None:
        self._fleet = fleet
        self._add_violation = add_violation

    def check_positions(self, phase: CampaignPhase) -> None:
        """Check invariant 17 now, for the jobs of a phase that are running: where a path is braked because a chunk came
        too late, all axes are on it, too."""
        for job_id, order in phase.jobs.items():
            step = order.job.steps[0]
            row = self._fleet.journal.load_record(job_id)
            if not isinstance(step, FollowPath) or row is None or row.state not in ("committed", "running"):
                continue
            lines = [piece for piece in step.pieces if isinstance(piece, LinePiece)]
            points = np.array([step.start, *(piece.to for piece in lines)], dtype=np.float64)
            position = np.array([self._find_position(axis) for axis in step.axes])
            corner_radius = max(float(line.corner.within) for line in lines if isinstance(line.corner, Within))
            distance = _find_distance(points, position)
            if distance > float(step.tolerance) + corner_radius:
                self._add_violation("17", f"{', '.join(step.axes)} are {distance:.3f} off their path, at {position}")

    def _find_position(self, name: str) -> float:
        axis = self._fleet.fleet.axis(name)
        return axis.to_unit(self._fleet.controllers[controller_of(name)].position(axis.motors[0]))


def _find_distance(points: Array, here: Array) -> float:
    """The distance from lines between points."""
    begins, ways = points[:-1], np.diff(points, axis=0)
    lengths = np.maximum((ways**2).sum(axis=1), 1e-12)
    shares = np.clip(((here - begins) * ways).sum(axis=1) / lengths, 0.0, 1.0)
    return float(np.sqrt(((begins + shares[:, None] * ways - here) ** 2).sum(axis=1)).min())
