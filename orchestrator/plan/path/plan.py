"""The plan of a path: positions over time, over length, and what limits it where."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from orchestrator.model.frame import FrameSpec
from orchestrator.model.paths.spec import PathSpec
from orchestrator.plan.path.arc_length import Array, Index
from orchestrator.plan.path.axes import AlongLimits, PathAxis, collect_limits
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.outline import Outline
from orchestrator.plan.path.resolve import ResolvedPath, resolve_path
from orchestrator.plan.path.run import Run, plan_run
from orchestrator.plan.path.soft_limits import check_table, check_track
from orchestrator.plan.path.tables import TableRun, TimedTable, plan_table

_ORDERS = ("", "speed", "acceleration", "jerk")


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of a path with one limit that binds: the most used one.

    t0_s, t1_s, s0, s1: when and where; piece: its number from 1; corner: whether it rounds the corner behind that
    piece; order: of the limit, 1 speed, 2 acceleration, 3 jerk, 0: the time is given by a table; axis: None: the path's
    own limit; used: the largest part of the limit that is used.
    """

    t0_s: float
    t1_s: float
    s0: float
    s1: float
    piece: int
    corner: bool
    order: int
    axis: str | None = None
    used: float = 1.0

    @property
    def words(self) -> str:
        """Which limit binds, in words."""
        location = f"the corner behind piece {self.piece}" if self.corner else f"piece {self.piece}"
        if self.order == 0:
            return f"{location}: its table"
        return f"{location}: {_ORDERS[self.order]} of {self.axis or 'the path'}, used to {self.used:.0%}"


class MotionRows(NamedTuple):
    """The motion of all axes: each (instants, axes), in the axes' units, per second (², ³)."""

    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array


@dataclass(frozen=True, slots=True)
class PathPlan:
    """A planned path: runs and tables, one after the other, each from rest to rest.

    starts_s, starts: when and at which length each part begins, one more entry.
    """

    axes: Sequence[str]
    parts: Sequence[Run | TableRun]
    starts_s: Array
    starts: Array

    @property
    def duration_s(self) -> float:
        """From the start of the motion to its end."""
        return float(self.starts_s[-1])

    @property
    def length(self) -> float:
        """The length of the path, in the unit of its coordinates."""
        return float(self.starts[-1])

    def evaluate(self, t: Array) -> MotionRows:
        """The motion of all axes at instants; at rest before the start and after the end."""
        t = np.asarray(t, dtype=np.float64)
        part_numbers = self._find_parts(self.starts_s, t)
        rows = [np.zeros((len(t), len(self.axes))) for _ in range(4)]
        for k, planned_part in enumerate(self.parts):
            at = np.flatnonzero(part_numbers == k)
            for target, part in zip(rows, planned_part.evaluate(t[at] - self.starts_s[k]), strict=True):
                target[at] = part
        return MotionRows(*rows)

    def path(self, s: Array) -> Array:
        """Positions of the axes at lengths of the path: (points, axes)."""
        s = np.asarray(s, dtype=np.float64)
        part_numbers = self._find_parts(self.starts, s)
        positions = np.zeros((len(s), len(self.axes)))
        for k, planned_part in enumerate(self.parts):
            at = np.flatnonzero(part_numbers == k)
            positions[at] = planned_part.find_positions(s[at] - self.starts[k])
        return positions

    def find_stretches(self) -> list[Stretch]:
        """The stretches of the path, in order: neighbours differ in the limit that binds, or in the piece."""
        stretches: list[Stretch] = []
        for part, t0, s0 in zip(self.parts, self.starts_s.tolist(), self.starts.tolist(), strict=False):
            if isinstance(part, TableRun):
                stretches.append(
                    Stretch(t0, t0 + part.duration_s, s0, s0 + part.length, part.piece + 1, corner=False, order=0)
                )
            else:
                stretches += _list_stretches(part, self.axes, t0, s0)
        return stretches

    def find_piece_ends(self) -> tuple[Index, Array]:
        """The numbers of the pieces, from 0, in their order, and when each ends; a rounded corner belongs to the piece
        before it."""
        pieces: list[Index] = []
        ends_s: list[Array] = []
        for part, t0 in zip(self.parts, self.starts_s.tolist(), strict=False):
            if isinstance(part, TableRun):
                pieces.append(np.array([part.piece]))
                ends_s.append(np.array([t0 + part.duration_s]))
            else:
                last = np.append(np.diff(part.track.piece) != 0, True)
                pieces.append(part.track.piece[last])
                ends_s.append(t0 + part.motion.find_instants(part.track.start[1:][last]))
        return np.concatenate(pieces), np.concatenate(ends_s)

    def _find_parts(self, starts: Array, at: Array) -> Index:
        return np.clip(np.searchsorted(starts, at, side="right") - 1, 0, len(self.parts) - 1)


def _list_stretches(run: Run, axes: Sequence[str], t0: float, s0: float) -> list[Stretch]:
    """The stretches of a run, from the use of limits in its segments."""
    motion, use = run.motion, run.use
    middle = motion.evaluate((motion.t + motion.ends_s) / 2)[0]
    span = run.track.find_spans(middle)
    keys = np.stack([run.track.piece[span], run.track.blend[span], use.order, use.axis])
    begin = np.flatnonzero(np.append(True, (np.diff(keys, axis=1) != 0).any(axis=0)))
    at_begin: list[list[int]] = keys[:, begin].T.tolist()
    ends_s = np.append(motion.t[begin[1:]], motion.duration_s)
    ends = np.append(motion.s[begin[1:]], motion.length)
    used = np.maximum.reduceat(use.used, begin)
    return [
        Stretch(
            t0_s=t0 + motion.t[k],
            t1_s=t0 + ends_s[n],
            s0=s0 + motion.s[k],
            s1=s0 + ends[n],
            piece=piece + 1,
            corner=bool(blend),
            order=order,
            axis=None if axis < 0 else axes[axis],
            used=float(used[n]),
        )
        for n, (k, (piece, blend, order, axis)) in enumerate(zip(begin.tolist(), at_begin, strict=True))
    ]


def plan_path(
    path: PathSpec | Outline | TimedTable,
    axes: Sequence[PathAxis],
    frames: Mapping[str, FrameSpec] | None = None,
    along: AlongLimits | None = None,
) -> PathPlan:
    """Plan a path within the limits of its axes, in their order; all that has to be known is known before it moves.

    path: as it is written, or already in numbers. frames: those of the fleet file. along: limits along a path that is
    in numbers; one that is written has its own. Raises `PathRefusal` naming the piece.
    """
    if isinstance(path, PathSpec):
        frame = None if path.frame is None else find_frame(path, frames or {})
        resolved_path = resolve_path(path, axes, frame)
    else:
        resolved_path = ResolvedPath([path], None, along or AlongLimits())
    return _plan_parts(resolved_path, list(axes))


def find_frame(path: PathSpec, frames: Mapping[str, FrameSpec]) -> FrameSpec:
    """The frame of a path that has one. Raises `PathRefusal` if it does not exist, or has other axes."""
    name = path.frame or ""
    frame = frames.get(name)
    if frame is None:
        frame_list = ", ".join(sorted(frames)) or "none"
        text = f"the path's frame {name!r} is not in the fleet file; it has: {frame_list}"
        raise PathRefusal("unknown-frame", text, "correct the name, or add the frame")
    if frame.axes != path.axes:
        text = f"the path has axes {', '.join(path.axes)}, and its frame {', '.join(frame.axes)}"
        raise PathRefusal("other-axes", text, "name the same axes in the same order")
    return frame


def _plan_parts(resolved: ResolvedPath, axes: list[PathAxis]) -> PathPlan:
    limits = collect_limits(axes, resolved.along)
    names = [axis.axis for axis in axes]
    parts: list[Run | TableRun] = []
    for part in resolved.parts:
        if isinstance(part, TimedTable):
            table = plan_table(part, resolved.frame, limits, names)
            check_table(table, axes)
            parts.append(table)
        else:
            run = plan_run(part, resolved.frame, limits)
            check_track(run.track, axes)
            parts.append(run)
    starts_s = np.cumsum([0.0, *(part.duration_s for part in parts)])
    starts = np.cumsum([0.0, *(part.length for part in parts)])
    return PathPlan(names, parts, starts_s, starts)
