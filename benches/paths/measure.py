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
        PathFigure(
            row=case.name,
            figure="error, p99",
            value=round(p99, 1),
            unit="um",
            asked=target,
            met=None if not target else p99 <= most,
        ),
        PathFigure(case.name, "error, largest", round(UM * float(errors.max()), 1), "um"),
        PathFigure(
            row=case.name,
            figure="paths above their bound",
            value=excess_count,
            unit="",
            asked="0",
            met=excess_count == 0,
        ),
        PathFigure(case.name, "largest term of the bound", None, note=worst),
        _make_sum_figure(case, ran),
    ]
    if case.controllers == TWO:
        is_kept = largest <= 300 if minute_p99 is None else None
        limit = "≤ 300" if minute_p99 is None else ""
        rows.append(
            PathFigure(
                row=case.name,
                figure="bound ahead, largest",
                value=round(largest, 1),
                unit="um",
                asked=limit,
                met=is_kept,
            )
        )
    else:
        rows.append(PathFigure(case.name, "bound ahead, largest", round(largest, 1), "um"))
    proven = [run.proven for run in ran if run.proven is not None]
    if proven and case.controllers == TWO:
        value = UM * median(proven)
        rows.append(
            PathFigure(
                row=case.name,
                figure="bound proven afterwards",
                value=round(value, 1),
                unit="um",
                asked="≤ 2 × p99",
                met=value <= 2 * p99,
            )
        )
    return rows + figures


def _make_sum_figure(case: CircleCase, ran: Sequence[CircleRun]) -> PathFigure:
    off = max(run.sum_off for run in ran)
    return PathFigure(
        row=case.name,
        figure="bound less the sum of its terms",
        value=round(UM * off, 6),
        unit="um",
        asked="0",
        met=off < 1e-9,
    )


def _measure_limits(counts: PathCounts, options: PathsOptions) -> list[PathFigure]:
    first = options.seed * counts.limits
    runs: list[LimitsRun] = list(map_in_processes(run_limits, range(first, first + counts.limits), options.processes))
    used = [run.worst for run in runs if run.worst is not None]
    worst = float(max(used))
    over = sum(1 for share in used if share > 1.001)
    refusal_count = len(runs) - len(used)
    return [
        PathFigure(
            row=LIMITS_ROW,
            figure=f"of {len(used)} paths, above a limit by more than 0.1 %",
            value=over,
            unit="",
            asked="0",
            met=over == 0,
        ),
        PathFigure(
            row=LIMITS_ROW,
            figure="largest part of a limit that is used",
            value=round(worst, 6),
            unit="",
            asked="≤ 1.001",
            met=worst <= 1.001,
        ),
        PathFigure(
            row=LIMITS_ROW, figure="paths refused", value=refusal_count, unit="", asked="0", met=refusal_count == 0
        ),
    ]


def _measure_times(counts: PathCounts, options: PathsOptions) -> list[PathFigure]:
    first = options.seed * counts.times
    runs: list[TimeRun] = list(map_in_processes(run_time, range(first, first + counts.times), options.processes))
    least = np.array([run.of_least for run in runs])
    middle, most = float(np.median(least)), float(np.quantile(least, 0.95))
    stopping = max(run.of_stopping for run in runs)
    note = "of velocity and acceleration alone, by the theory of TOPP-RA"
    return [
        PathFigure(
            row=TIME_ROW,
            figure="times the least time, median",
            value=round(middle, 3),
            unit="",
            asked="≤ 1.15",
            met=middle <= 1.15,
            note=note,
        ),
        PathFigure(
            row=TIME_ROW,
            figure="times the least time, p95",
            value=round(most, 3),
            unit="",
            asked="≤ 1.4",
            met=most <= 1.4,
        ),
        PathFigure(
            row=TIME_ROW,
            figure="times the time with stops, largest",
            value=round(stopping, 3),
            unit="",
            asked="≤ 1",
            met=stopping <= 1 + 1e-9,
        ),
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
        PathFigure(
            row=COST_ROW,
            figure=f"a line over 8 axes, {few_pieces} pieces",
            value=round(lines),
            unit="us",
            asked="≤ 300",
            met=lines <= 300,
        ),
        PathFigure(
            row=COST_ROW,
            figure=f"a mixed piece over 8 axes, {few_pieces} pieces",
            value=round(mixed_cost),
            unit="us",
            asked="≤ 300",
            met=mixed_cost <= 300,
        ),
        PathFigure(
            row=COST_ROW,
            figure=f"a line of {many_pieces} to one of {few_pieces}",
            value=round(ratio, 2),
            unit="",
            asked="≤ 1.2",
            met=ratio <= 1.2,
        ),
        PathFigure(
            row=COST_ROW,
            figure="a line of G-code to geometry",
            value=round(gcode.us_line),
            unit="us",
            asked="≤ 100",
            met=gcode.us_line <= 100,
        ),
        PathFigure(
            row=COST_ROW,
            figure=f"memory, {counts.gcode_lines} lines of G-code",
            value=round(gcode.peak_mb),
            unit="MB",
            asked="≤ 500",
            met=gcode.peak_mb <= 500,
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
        PathFigure(
            row=row,
            figure=f"of {edges} pulses, without a row or evidence",
            value=misses,
            unit="",
            asked="0",
            met=misses == 0,
        ),
        PathFigure(
            row=row,
            figure="outside their interval by evidence",
            value=by_evidence,
            unit="",
            asked="0",
            met=by_evidence == 0,
        ),
        PathFigure(row=row, figure="outside their promise", value=by_promise, unit="", asked="0", met=by_promise == 0),
    ]
    widest = {
        "on moves": max(run.widest_move_ns for run in runs),
        "along paths": max(run.widest_path_ns for run in runs),
    }
    for way, widest_ns in widest.items():
        value = widest_ns / NS_PER_MS
        figures.append(
            PathFigure(
                row=row,
                figure=f"interval {way}, largest",
                value=round(value, 2),
                unit="ms",
                asked=f"≤ {MOST_MS}",
                met=value <= MOST_MS,
            )
        )
    return figures
