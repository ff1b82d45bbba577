"""The benchmark of paths: its rows, how they are judged, and that few paths keep what is asked."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from benches.__main__ import main as benches
from benches.paths.circles import CircleRun, make_fleet
from benches.paths.measure import (
    LONG,
    MAKES,
    MINUTE,
    PathsOptions,
    bench_paths,
    make_circle_figures,
    make_trigger_figures,
)
from benches.paths.pulses import PulsesRun, PulsesTask, run_pulses
from benches.registry.benchmarks import BENCHMARKS

# What the controllers state about their starts is known to some tenths of a millisecond, by the shortest round trip of
# their links; they start closer together than that.
OPEN = {"bound proven afterwards"}


def test_circles_keep_what_is_asked() -> None:
    words = ["paths", "--quick", "--only", "2 SMC-4000", "--paths", "1", "--json"]
    shown = CliRunner().invoke(benches, words)
    rows = json.loads(shown.stdout)["rows"]
    assert {row["row"] for row in rows} == {"2 SMC-4000, 10 s"}
    missed = [row for row in rows if row["met"] is False and row["figure"] not in OPEN]
    assert not missed
    value = {(row["row"], row["figure"]): row["value"] for row in rows}
    first = rows[0]["row"]
    # One path: what was proven afterwards is no more than what was stated ahead, and no less than the truth.
    assert value[first, "error, largest"] <= value[first, "bound proven afterwards"]
    assert value[first, "bound proven afterwards"] <= value[first, "bound ahead, largest"]


def make_run(error: float, bound: float) -> CircleRun:
    return CircleRun(np.full(100, error), bound, 0.0, bound, "clock of a")


def test_a_path_above_its_bound_fails_the_benchmark() -> None:
    figures = make_circle_figures(MINUTE, [make_run(0.01, 0.2), make_run(0.3, 0.2)])
    found = {each.figure: each for each in figures}
    assert found["paths above their bound"].value == 1 and found["paths above their bound"].met is False
    assert BENCHMARKS["paths"].has_failed({"rows": figures})
    assert found["largest term of the bound"].note == "clock of a"


def test_a_long_row_is_compared_with_that_of_a_minute() -> None:
    kept, missed = (make_circle_figures(LONG, [make_run(error, 1.0)], 10.0)[0].met for error in (0.0129, 0.0131))
    assert kept is True and missed is False


def test_a_row_whose_paths_are_refused_says_why() -> None:
    (figure,) = make_circle_figures(LONG, [CircleRun(np.zeros(0), refused="contour-too-long: a")])
    assert (figure.value, figure.met, figure.note) == (1, False, "contour-too-long: a")


def test_a_fleet_of_a_row_has_a_controller_of_each_make() -> None:
    from random import Random

    adapters = [each.adapter for each in make_fleet(MAKES, Random(1)).controllers.values()]
    assert adapters == ["smc4000", "cia402", "smc2000"]


def test_pulses_keep_what_is_asked() -> None:
    # Of some fleets one whose clock was known worst while one reading of a second was kept: 2.6 ms.
    run = run_pulses(PulsesTask(400, 24))
    assert run.edges >= 400 and all(figure.met for figure in make_trigger_figures([run]))


def test_pulses_outside_their_intervals_fail_the_benchmark() -> None:
    good = PulsesRun(400, widest_move_ns=2_000_000, widest_path_ns=2_500_000)
    assert not BENCHMARKS["paths"].has_failed({"rows": make_trigger_figures([good])})
    bad = [
        good._replace(missed=1),
        good._replace(outside_seen=1),
        good._replace(outside_promise=1),
        good._replace(widest_move_ns=2_510_000),
        good._replace(widest_path_ns=2_510_000),
        good._replace(refused="trigger-rate: a"),
    ]
    for run in bad:
        assert sum(figure.met is False for figure in make_trigger_figures([good, run])) == 1


@pytest.mark.nightly
@pytest.mark.timeout(1200)
def test_the_quick_form_keeps_what_is_asked() -> None:
    missed = [each for each in bench_paths(PathsOptions(quick=True)) if each.met is False and each.figure not in OPEN]
    assert not missed
