"""The figures of paths: how far members of several makes are off them, and how good and how cheap plans are."""

import re
from collections.abc import Callable, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np

from orchestrator.bench.paths.circles import CircleCase, CircleRun, CircleTask, list_tasks, run_circle
from orchestrator.bench.paths.planning import (
    LimitsRun,
    TimeRun,
    measure_gcode,
    measure_planning,
    run_limits,
    run_time,
)
from orchestrator.bench.paths.pulses import PulsesRun, PulsesTask, run_pulses
from orchestrator.bench.paths.random_paths import KINDS
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


FULL = PathCounts(200, 10, 10_000, 200, (1000, 10_000), 5, 100_000, 10_000)
QUICK = PathCounts(5, 0, 80, 20, (1000, 10_000), 2, 10_000, 800)


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
        figures.append(
            PathFigure(case.name, "paths refused", len(refused_runs), "", "0", met=False, note=refused_runs[0])
        )
    if not ran:
        return figures
    errors = np.concatenate([run.errors for run in ran])
    p99 = UM * float(np.percentile(errors, 99))
    excess_count = sum(float(run.errors.max()) > run.bound for run in ran)
    largest = max(run.bound for run in ran) * UM
    worst = max({run.worst for run in ran}, key=lambda member: sum(run.worst == member for run in ran))
    most, target = (60.0, "≤ 60") if minute_p99 is None else (1.3 * minute_p99, "≤ 1.3 × of 60 s")
    if case.controllers != TWO:
        most, target = np.inf, ""
    rows = [
        PathFigure(case.name, "error, p99", round(p99, 1), "um", target, None if not target else p99 <= most),
        PathFigure(case.name, "error, largest", round(UM * float(errors.max()), 1), "um"),
        PathFigure(case.name, "paths above their bound", excess_count, "", "0", excess_count == 0),
        PathFigure(case.name, "largest term of the bound", None, note=worst),
        _make_sum_figure(case, ran),
    ]
    if case.controllers == TWO:
        is_kept = largest <= 300 if minute_p99 is None else None
        limit = "≤ 300" if minute_p99 is None else ""
        rows.append(PathFigure(case.name, "bound ahead, largest", round(largest, 1), "um", limit, is_kept))
    else:
        rows.append(PathFigure(case.name, "bound ahead, largest", round(largest, 1), "um"))
    proven = [run.proven for run in ran if run.proven is not None]
    if proven and case.controllers == TWO:
        value = UM * median(proven)
        rows.append(
            PathFigure(case.name, "bound proven afterwards", round(value, 1), "um", "≤ 2 × p99", value <= 2 * p99)
        )
    return rows + figures


def _make_sum_figure(case: CircleCase, ran: Sequence[CircleRun]) -> PathFigure:
    off = max(run.sum_off for run in ran)
    return PathFigure(case.name, "bound less the sum of its terms", round(UM * off, 6), "um", "0", off < 1e-9)


def _measure_limits(counts: PathCounts, options: PathsOptions) -> list[PathFigure]:
    first = options.seed * counts.limits
    runs: list[LimitsRun] = list(map_in_processes(run_limits, range(first, first + counts.limits), options.processes))
    used = [run.worst for run in runs if run.worst is not None]
    worst = float(max(used))
    over = sum(1 for share in used if share > 1.001)
    refusal_count = len(runs) - len(used)
    return [
        PathFigure(LIMITS_ROW, f"of {len(used)} paths, above a limit by more than 0.1 %", over, "", "0", over == 0),
        PathFigure(LIMITS_ROW, "largest part of a limit that is used", round(worst, 6), "", "≤ 1.001", worst <= 1.001),
        PathFigure(LIMITS_ROW, "paths refused", refusal_count, "", "0", refusal_count == 0),
    ]


def _measure_times(counts: PathCounts, options: PathsOptions) -> list[PathFigure]:
    first = options.seed * counts.times
    runs: list[TimeRun] = list(map_in_processes(run_time, range(first, first + counts.times), options.processes))
    least = np.array([run.of_least for run in runs])
    middle, most = float(np.median(least)), float(np.quantile(least, 0.95))
    stopping = max(run.of_stopping for run in runs)
    note = "of velocity and acceleration alone, by the theory of TOPP-RA"
    return [
        PathFigure(TIME_ROW, "times the least time, median", round(middle, 3), "", "≤ 1.15", middle <= 1.15, note),
        PathFigure(TIME_ROW, "times the least time, p95", round(most, 3), "", "≤ 1.4", most <= 1.4),
        PathFigure(TIME_ROW, "times the time with stops, largest", round(stopping, 3), "", "≤ 1", stopping <= 1 + 1e-9),
    ]


def _measure_costs(counts: PathCounts, _: PathsOptions) -> list[PathFigure]:
    few_pieces, many_pieces = counts.pieces
    lines = measure_planning(few_pieces, ("line",), counts.rounds)
    long = measure_planning(many_pieces, ("line",), counts.rounds)
    mixed_cost = measure_planning(few_pieces, KINDS, counts.rounds)
    # In a process of its own, whose memory is that of the program alone.
    (gcode,) = map_in_processes(measure_gcode, [counts.gcode_lines], 2)
    ratio = long / lines
    return [
        PathFigure(COST_ROW, f"a line over 8 axes, {few_pieces} pieces", round(lines), "us", "≤ 300", lines <= 300),
        PathFigure(
            COST_ROW,
            f"a mixed piece over 8 axes, {few_pieces} pieces",
            round(mixed_cost),
            "us",
            "≤ 300",
            mixed_cost <= 300,
        ),
        PathFigure(
            COST_ROW, f"a line of {many_pieces} to one of {few_pieces}", round(ratio, 2), "", "≤ 1.2", ratio <= 1.2
        ),
        PathFigure(COST_ROW, "a line of G-code to geometry", round(gcode.us_line), "us", "≤ 100", gcode.us_line <= 100),
        PathFigure(
            COST_ROW,
            f"memory, {counts.gcode_lines} lines of G-code",
            round(gcode.peak_mb),
            "MB",
            "≤ 500",
            gcode.peak_mb <= 500,
        ),
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
        PathFigure(row, "fleets refused", len(refused_runs), "", "0", met=False, note=refused_runs[0])
        for _ in refused_runs[:1]
    ]
    by_evidence, by_promise = sum(run.outside_seen for run in runs), sum(run.outside_promise for run in runs)
    figures += [
        PathFigure(row, f"of {edges} pulses, without a row or evidence", misses, "", "0", misses == 0),
        PathFigure(row, "outside their interval by evidence", by_evidence, "", "0", by_evidence == 0),
        PathFigure(row, "outside their promise", by_promise, "", "0", by_promise == 0),
    ]
    widest = {
        "on moves": max(run.widest_move_ns for run in runs),
        "along paths": max(run.widest_path_ns for run in runs),
    }
    for way, widest_ns in widest.items():
        value = widest_ns / NS_PER_MS
        figures.append(
            PathFigure(row, f"interval {way}, largest", round(value, 2), "ms", f"≤ {MOST_MS}", value <= MOST_MS)
        )
    return figures
