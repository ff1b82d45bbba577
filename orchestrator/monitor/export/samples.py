"""Tables of recorded positions: the readings as they came, and all axes on one grid of fleet time."""

# NumPy types interpolation only in part.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.errors import TuttiError
from orchestrator.model.report import StepRecording
from orchestrator.monitor.export.recorded import RecordedReading, RecordedRun
from orchestrator.monitor.export.table import Column, DataTable

MAX_GAP_NS = 2 * NS_PER_S  # between two readings; in a longer gap the position is not known
LEAST_PERIOD_NS, MOST_PERIOD_NS = NS_PER_MS, NS_PER_S
MAX_ROWS = 20_000_000

_SAMPLE_COLUMNS = (
    "fleet_ns",
    "utc_ns",
    "axis",
    "position",
    "commanded",
    "velocity",
    "motor_position",
    "raw_counts",
    "unit",
    "moving",
    "mode",
)

_DEVICE_COLUMNS = ("fleet_ns", "utc_ns", "t_lo_ns", "t_hi_ns", "step", "axis", "position", "unit")

Array = NDArray[Any]


class ExportTooLarge(TuttiError):
    """The table would have too many rows. The text names the number, and the remedy."""


def make_samples_table(run: RecordedRun) -> DataTable:
    """Every reading of every axis as it came, in order of time: one row each. Positions in the unit of their row."""
    rows = [
        (reading.fleet_ns, reading.utc_ns, name, *reading[2:])
        for name, readings in run.readings.items()
        for reading in readings
    ]
    rows.sort(key=lambda row: (row[0], row[2]))
    columns: dict[str, Column] = {name: [row[number] for row in rows] for number, name in enumerate(_SAMPLE_COLUMNS)}
    return DataTable("samples", columns, {"fleet_ns": "ns", "utc_ns": "ns"}, _describe(run))


def make_device_table(run: RecordedRun) -> DataTable:
    """Positions that controllers have sampled by themselves (motor positions): one row each, with the interval that
    certainly contains its instant, `t_lo_ns` to `t_hi_ns`, fleet time."""
    offset_ns, rows = run.utc_offset_ns, list[tuple[Any, ...]]()
    for sample in run.samples:
        for name, axis in sample.axes.items():
            for at_ns, counts in zip(sample.fleet_ns, axis.counts, strict=True):
                interval = at_ns - sample.bound_ns, at_ns + sample.bound_ns
                position = counts / axis.counts_per_unit
                rows.append(
                    (
                        at_ns,
                        at_ns + offset_ns,
                        *interval,
                        sample.step,
                        f"{sample.controller}.{name}",
                        position,
                        axis.unit,
                    )
                )
    rows.sort(key=lambda row: (row[0], row[5]))
    columns: dict[str, Column] = {name: [row[number] for row in rows] for number, name in enumerate(_DEVICE_COLUMNS)}
    return DataTable("device", columns, dict.fromkeys(_DEVICE_COLUMNS[:4], "ns"), _describe(run))


def make_grid_table(run: RecordedRun, period_ns: int | None = None) -> DataTable:
    """All axes on one grid of fleet time, from the first reading to the last: one row an instant.

    Columns: `fleet_ns`, `utc_ns`, `step` (-1 between motion steps), and for each axis its position, commanded position
    and velocity, interpolated linearly between readings (NaN where there is none within 2 s), and where there are plans
    its planned position, exactly (motor position; NaN outside of its steps). period_ns: None: the median time between
    readings of the axis that is read most often. Raises `ExportTooLarge`.
    """
    readings = {name: axis_readings for name, axis_readings in sorted(run.readings.items()) if axis_readings}
    if not readings:
        return DataTable("grid", {"fleet_ns": (), "utc_ns": (), "step": ()}, {}, _describe(run))
    period_ns = period_ns or _find_period_ns(readings)
    begin_ns = min(axis_readings[0].fleet_ns for axis_readings in readings.values())
    end_ns = max(axis_readings[-1].fleet_ns for axis_readings in readings.values())
    count = (end_ns - begin_ns) // period_ns + 1
    if count * len(readings) > MAX_ROWS:
        raise ExportTooLarge(
            f"{count} instants of {len(readings)} axes are more than {MAX_ROWS} values; choose a longer --period"
        )
    grid: Array = begin_ns + period_ns * np.arange(count, dtype=np.int64)
    columns: dict[str, Any] = {"fleet_ns": grid, "utc_ns": grid + run.utc_offset_ns}
    columns["step"] = _mark_steps(run.plans, grid)
    units = {"fleet_ns": "ns", "utc_ns": "ns"}
    for name, reading in readings.items():
        unit = reading[-1].unit
        grid_columns = {
            f"{name}.position": _interpolate(grid, reading, [sample.position for sample in reading]),
            f"{name}.commanded": _interpolate(grid, reading, [sample.commanded for sample in reading]),
            f"{name}.velocity": _interpolate(grid, reading, [sample.velocity for sample in reading]),
        }
        plan = _sample_plans(run.plans, name, grid)
        if plan is not None:
            grid_columns[f"{name}.planned"] = plan
        columns |= grid_columns
        units |= {column: f"{unit}/s" if column.endswith(".velocity") else unit for column in grid_columns}
    return DataTable("grid", columns, units, _describe(run))


def _find_period_ns(readings: Mapping[str, Sequence[RecordedReading]]) -> int:
    """The median time between readings of the axis that is read most often."""
    medians = [
        median(
            reading_later.fleet_ns - earlier_reading.fleet_ns for earlier_reading, reading_later in pairwise(reading)
        )
        for reading in readings.values()
        if len(reading) > 1
    ]
    return round(min(max(min(medians, default=MOST_PERIOD_NS), LEAST_PERIOD_NS), MOST_PERIOD_NS))


def _interpolate(grid: Array, readings: Sequence[RecordedReading], values: Sequence[float]) -> Array:
    at_ns = np.array([reading.fleet_ns for reading in readings], dtype=np.int64)
    # Relative to the first instant: doubles have no room for ns of weeks.
    known_values = np.array(values, dtype=np.float64)
    on_grid: Array = np.interp(grid - at_ns[0], at_ns - at_ns[0], known_values, left=np.nan, right=np.nan)
    rows = np.clip(np.searchsorted(at_ns, grid), 1, max(1, len(at_ns) - 1))
    if len(at_ns) > 1:
        on_grid[(at_ns[rows] - at_ns[rows - 1] > MAX_GAP_NS) & (grid != at_ns[rows])] = np.nan
    return on_grid


def _mark_steps(plans: Sequence[StepRecording], grid: Array) -> Array:
    steps: Array = np.full(len(grid), -1, dtype=np.int64)
    for plan in plans:
        longest_s = max((axis.profile.duration_s for axis in plan.axes.values()), default=0.0)
        steps[(grid >= plan.t0_fleet_ns) & (grid <= plan.t0_fleet_ns + longest_s * NS_PER_S)] = plan.step
    return steps


def _sample_plans(plans: Sequence[StepRecording], name: str, grid: Array) -> Array | None:
    """The planned motor position of an axis on the grid; None: it has no plan."""
    axis_plans = [recording for recording in plans if name in recording.axes]
    if not axis_plans:
        return None
    positions: Array = np.full(len(grid), np.nan)
    for plan in axis_plans:
        axis = plan.axes[name]
        first, last = np.searchsorted(
            grid, [plan.t0_fleet_ns, plan.t0_fleet_ns + round(axis.profile.duration_s * NS_PER_S) + 1]
        )
        at = axis.profile.make_evaluator()
        for row in range(first, last):
            counts = axis.profile.start_counts + at((grid[row] - plan.t0_fleet_ns) / NS_PER_S).position
            positions[row] = counts / axis.counts_per_unit
    return positions


def _describe(run: RecordedRun) -> dict[str, str]:
    """What belongs to a job's tables as metadata: the job, and the verdicts of its steps."""
    report = run.report
    if report is None:
        return {}
    verdicts = {str(step.index): step.verdict for step in report.steps if step.verdict != "none"}
    return {
        "job_id": report.job_id,
        "job": report.name,
        "actor": report.actor,
        "state": report.state,
        "started_utc": report.started_utc or "",
        "ended_utc": report.ended_utc or "",
        "verdicts": json.dumps(verdicts),
    }
