"""The figures of paths: how far members of several makes are off them, and how good and how cheap plans are."""

import re
from collections.abc import Callable, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np

from benches.paths.circles import CircleCase, CircleRun, CircleTask, list_tasks, run_circle
from benches.paths.planning import (
    LimitsRun,
    TimeRun,
    measure_gcode,
    measure_planning,
    run_limits,
    run_time,
)
from benches.paths.pulses import PulsesRun, PulsesTask, run_pulses
from benches.paths.random_paths import KINDS
from orchestrator.clock.base import NS_PER_MS
from orchestrator.runtime.workers import map_in_processes

UM = 1000.0  # of a mm
TWO = ("smc4000", "smc4000")
MIXED = ("smc4000", "cia402", "smc2000")
MINUTE = CircleCase("2 SMC-4000, 60 s", TWO, 60, 300, "1 mm")
LONG = CircleCase("2 SMC-4000, 600 s", TWO, 600, 300, "2 mm")
MAKES = CircleCase("SMC-4000, CiA 402, SMC-2000, 30 s", MIXED, 30, 300, "2 mm")
QUICK_S, QUICK_HISTORY_S = 10, 40
LIMITS_ROW, TIME_ROW, COST_ROW, TRIGGERS_ROW = "limits", "time", "cost", "triggers"
PULSES_A_FLEET = 400
MOST_MS = 2.5  # of the interval in which a pulse is known to have begun


class PathFigure(NamedTuple):
    """One figure of a row. asked: its limit, in words; met: whether it is kept; None: it has no limit, or was not
    measured. note: more about it."""

    row: str
    figure: str
    value: float | None
    unit: str = ""
    asked: str = ""
    met: bool | None = None
    note: str = ""

    def judge(self, most: float, digits: int | None = None, asked: str = "") -> "PathFigure":
        """Return the figure, rounded, beside its limit. asked: the limit in words, where it is not a number alone."""
        assert self.value is not None
        words = asked or (f"≤ {most:g}" if most else "0")
        return self._replace(value=round(self.value, digits), asked=words, met=self.value <= most)


class PathCounts(NamedTuple):
    """How many paths each row has, and how much of the costs is measured."""

    circles: int
    long_circles: int
    limits: int
    times: int
    pieces: tuple[int, int]
    rounds: int
    gcode_lines: int
    pulses: int


FULL = PathCounts(
    circles=200,
    long_circles=10,
    limits=10_000,
    times=200,
    pieces=(1000, 10_000),
    rounds=5,
    gcode_lines=100_000,
    pulses=10_000,
)
QUICK = PathCounts(
    circles=5, long_circles=0, limits=80, times=20, pieces=(1000, 10_000), rounds=2, gcode_lines=10_000, pulses=800
)


class PathsOptions(NamedTuple):
    """only: a regular expression for the names of the rows to run. paths: of each row of circles, instead of the usual
    number."""

    quick: bool
    seed: int = 1
    only: str = ""
    processes: int = 1
    paths: int | None = None


def bench_paths(options: PathsOptions, on_row: Callable[[str], None] = lambda _: None) -> list[PathFigure]:
    """Run the chosen rows."""
    found_paths: list[PathFigure] = []
    counts = QUICK if options.quick else FULL
    minute_p99 = None
    for case in (MINUTE, LONG, MAKES):
        paths = counts.long_circles if case is LONG else counts.circles
        if options.paths is not None:
            paths = min(paths, options.paths)
        if options.quick:
            name = case.name.rpartition(",")[0] + f", {QUICK_S} s"
            case = case._replace(name=name, duration_s=QUICK_S, history_s=QUICK_HISTORY_S)
        if not paths or not re.search(options.only, case.name):
            continue
        on_row(case.name)
        tasks: list[CircleTask] = list(list_tasks(case, paths, options.seed))
        runs = list(map_in_processes(run_circle, tasks, options.processes))
        is_long = case.name == LONG.name
        figures = make_circle_figures(case, runs, minute_p99 if is_long else None)
        if case.controllers == TWO and not is_long:
            minute_p99 = figures[0].value
        found_paths += figures
    other_rows = {
        LIMITS_ROW: _measure_limits,
        TIME_ROW: _measure_times,
        COST_ROW: _measure_costs,
        TRIGGERS_ROW: _measure_triggers,
    }
    for name, measure in other_rows.items():
        if re.search(options.only, name):
            on_row(name)
            found_paths += measure(counts, options)
    return found_paths


def make_circle_figures(
    case: CircleCase, runs: Sequence[CircleRun], minute_p99: float | None = None
) -> list[PathFigure]:
    """The figures of a row of circles. minute_p99: of the row that a long one is compared with."""
    refused_runs = [run.refused for run in runs if run.refused]
    ran = [run for run in runs if not run.refused and len(run.errors)]
    figures: list[PathFigure] = []
    if refused_runs:
        figures.append(PathFigure(case.name, "paths refused", len(refused_runs), note=refused_runs[0]).judge(0))
    if not ran:
        return figures
    errors = np.concatenate([run.errors for run in ran])
    p99 = UM * float(np.percentile(errors, 99))
    excess_count = sum(float(run.errors.max()) > run.bound for run in ran)
    largest = max(run.bound for run in ran) * UM
    worst = max({run.worst for run in ran}, key=lambda member: sum(run.worst == member for run in ran))
    error = PathFigure(case.name, "error, p99", p99, "um")
    bound = PathFigure(case.name, "bound ahead, largest", largest, "um")
    if case.controllers != TWO:
        error, bound = error._replace(value=round(p99, 1)), bound._replace(value=round(largest, 1))
    elif minute_p99 is None:
        error, bound = error.judge(60, 1), bound.judge(300, 1)
    else:
        error = error.judge(1.3 * minute_p99, 1, "≤ 1.3 × of 60 s")
        bound = bound._replace(value=round(largest, 1))
    sum_off = max(run.sum_off for run in ran)
    rows = [
        error,
        PathFigure(case.name, "error, largest", round(UM * float(errors.max()), 1), "um"),
        PathFigure(case.name, "paths above their bound", excess_count).judge(0),
        PathFigure(case.name, "largest term of the bound", None, note=worst),
        # Zero but for rounding: 1 pm.
        PathFigure(case.name, "bound less the sum of its terms", UM * sum_off, "um").judge(UM * 1e-9, 6, "0"),
        bound,
    ]
    proven = [run.proven for run in ran if run.proven is not None]
    if proven and case.controllers == TWO:
        value = UM * median(proven)
        figure = PathFigure(case.name, "bound proven afterwards", value, "um")
        rows.append(figure.judge(2 * p99, 1, "≤ 2 × p99"))
    return rows + figures


def _measure_limits(counts: PathCounts, options: PathsOptions) -> list[PathFigure]:
    first = options.seed * counts.limits
    runs: list[LimitsRun] = list(map_in_processes(run_limits, range(first, first + counts.limits), options.processes))
    used = [run.worst for run in runs if run.worst is not None]
    worst = float(max(used))
    over = sum(1 for share in used if share > 1.001)
    refusal_count = len(runs) - len(used)
    excess = f"of {len(used)} paths, above a limit by more than 0.1 %"
    return [
        PathFigure(LIMITS_ROW, excess, over).judge(0),
        PathFigure(LIMITS_ROW, "largest part of a limit that is used", worst).judge(1.001, 6),
        PathFigure(LIMITS_ROW, "paths refused", refusal_count).judge(0),
    ]


def _measure_times(counts: PathCounts, options: PathsOptions) -> list[PathFigure]:
    first = options.seed * counts.times
    runs: list[TimeRun] = list(map_in_processes(run_time, range(first, first + counts.times), options.processes))
    least = np.array([run.of_least for run in runs])
    middle, most = float(np.median(least)), float(np.quantile(least, 0.95))
    stopping = max(run.of_stopping for run in runs)
    note = "of velocity and acceleration alone, by the theory of TOPP-RA"
    return [
        PathFigure(TIME_ROW, "times the least time, median", middle, note=note).judge(1.15, 3),
        PathFigure(TIME_ROW, "times the least time, p95", most).judge(1.4, 3),
        PathFigure(TIME_ROW, "times the time with stops, largest", stopping).judge(1 + 1e-9, 3, "≤ 1"),
    ]


def _measure_costs(counts: PathCounts, _: PathsOptions) -> list[PathFigure]:
    few_pieces, many_pieces = counts.pieces
    lines = measure_planning(few_pieces, ("line",), counts.rounds)
    long = measure_planning(many_pieces, ("line",), counts.rounds)
    mixed_cost = measure_planning(few_pieces, KINDS, counts.rounds)
    # In a process of its own, whose memory is that of the program alone.
    (gcode,) = map_in_processes(measure_gcode, [counts.gcode_lines], 2)
    ratio = long / lines
    memory = PathFigure(COST_ROW, f"memory, {counts.gcode_lines} lines of G-code", gcode.peak_mb, "MB")
    return [
        PathFigure(COST_ROW, f"a line over 8 axes, {few_pieces} pieces", lines, "us").judge(300),
        PathFigure(COST_ROW, f"a mixed piece over 8 axes, {few_pieces} pieces", mixed_cost, "us").judge(300),
        PathFigure(COST_ROW, f"a line of {many_pieces} to one of {few_pieces}", ratio).judge(1.2, 2),
        PathFigure(COST_ROW, "a line of G-code to geometry", gcode.us_line, "us").judge(100),
        memory.judge(500),
    ]


def _measure_triggers(counts: PathCounts, options: PathsOptions) -> list[PathFigure]:
    fleets = max(1, counts.pulses // PULSES_A_FLEET)
    tasks = [PulsesTask(PULSES_A_FLEET, options.seed * 1000 + number) for number in range(fleets)]
    return make_trigger_figures(list(map_in_processes(run_pulses, tasks, options.processes)))


def make_trigger_figures(runs: Sequence[PulsesRun]) -> list[PathFigure]:
    """The figures of pulses on the way of moves and along paths."""
    row = TRIGGERS_ROW
    refused_runs = [run.refused for run in runs if run.refused]
    edges, misses = sum(run.edges for run in runs), sum(run.missed for run in runs)
    figures = [
        PathFigure(row, "fleets refused", len(refused_runs), note=reason).judge(0) for reason in refused_runs[:1]
    ]
    by_evidence, by_promise = sum(run.outside_seen for run in runs), sum(run.outside_promise for run in runs)
    figures += [
        PathFigure(row, f"of {edges} pulses, without a row or evidence", misses).judge(0),
        PathFigure(row, "outside their interval by evidence", by_evidence).judge(0),
        PathFigure(row, "outside their promise", by_promise).judge(0),
    ]
    widest = {
        "on moves": max(run.widest_move_ns for run in runs),
        "along paths": max(run.widest_path_ns for run in runs),
    }
    for way, widest_ns in widest.items():
        figures.append(PathFigure(row, f"interval {way}, largest", widest_ns / NS_PER_MS, "ms").judge(MOST_MS, 2))
    return figures
