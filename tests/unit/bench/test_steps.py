"""The benchmark of steps back to back: its fleets, its scripts, and what it reads from the wires."""

import json
from itertools import pairwise

import pytest
from click.testing import CliRunner

from orchestrator.bench import steps
from orchestrator.bench.field_scripts import OURS, SCRIPTS
from orchestrator.bench.naive import find_gaps, find_whole_ns, measure_script
from orchestrator.bench.step_fleets import AskedGap, StepsFleet, find_counts, list_fleets, make_scan_fleet
from orchestrator.bench.step_wire import find_gap
from orchestrator.bench.steps import list_scripts, list_sources, measure_scan, measure_virtual
from orchestrator.cli.main import main
from orchestrator.clock.base import NS_PER_MS

FLEETS = {fleet.name: fleet for fleet in list_fleets()}
STEPS = 10


def measure_first_script(fleet: StepsFleet, moves: int = 3) -> list[list[tuple[int, int]]]:
    ((_, loops), *_) = list_scripts(fleet.fleet)
    targets = [dict(fleet.counts) if number % 2 == 0 else dict.fromkeys(fleet.counts, 0) for number in range(moves)]
    return list(measure_script(fleet.fleet, loops, targets).values())


def test_there_is_a_row_for_each_line_of_the_figures() -> None:
    assert list(FLEETS) == [
        "1 SMC-4000, 28 ms",
        "1 SMC-4000, 90 ms",
        "1 SMC-4000, 400 ms",
        "1 SHRC-203, 100 ms",
        "1 SHRC-203, 400 ms",
        "1 SMC30, 400 ms",
        "1 pp-electronic SMC, 140 ms",
        "1 CiA 402 drive, 400 ms",
        "8 SMC-4000, 90 ms",
        "SMC-4000 + SHRC-203, 220 ms",
        "7 SMC30 on one bus, 400 ms",
    ]
    assert set(make_scan_fleet().counts.values()) == {125}


@pytest.mark.parametrize("name", ["1 SMC-4000, 28 ms", "1 SHRC-203, 100 ms", "7 SMC30 on one bus, 400 ms"])
def test_the_script_makes_each_move_once_in_about_its_time(name: str) -> None:
    fleet = FLEETS[name]
    asked_ms = float(name.split(", ")[1].removesuffix(" ms"))
    for motions in measure_first_script(fleet):
        assert len(motions) == 3
        for start_ns, end_ns in motions:
            assert (end_ns - start_ns) / NS_PER_MS == pytest.approx(asked_ms, rel=0.2)


@pytest.mark.parametrize("adapter", SCRIPTS)
def test_every_script_of_a_make_moves_its_controller(adapter: str) -> None:
    fleet = next(
        fleet
        for fleet in FLEETS.values()
        if [config.adapter for config in fleet.fleet.controllers.values()] == [adapter]
    )
    medians: dict[str, int] = {}
    for name, loops in list_scripts(fleet.fleet):
        (axis,) = fleet.counts
        (motions,) = measure_script(fleet.fleet, loops, [dict(fleet.counts), {axis: 0}]).values()
        assert len(motions) == 2 and all(end_ns > start_ns for start_ns, end_ns in motions)
        (medians[name],) = find_gaps([motions])
    assert next(iter(medians)) == OURS and len(medians) >= 2


def test_the_duration_of_a_move_sets_its_distance() -> None:
    axis = FLEETS["1 SMC-4000, 90 ms"].fleet.axis("c0.x")  # 200 mm/s, 1000 mm/s², 1000 counts a mm
    assert find_counts(axis, 28) == 196  # a t² / 4: no time to reach the velocity
    assert find_counts(axis, 400) == 40_000  # v (t - v / a): just reached
    assert find_counts(axis, 600) == 80_000


def test_the_bound_is_the_largest_of_those_asked_for() -> None:
    asked = AskedGap(script=2.0, wire=1.0, wire_more_ms=3.0)
    assert asked.bound_ms(20.0, 30.0) == 40.0 and asked.bound_ms(20.0, 50.0) == 53.0
    assert str(asked) == "2 x script or wire + 3 ms"
    assert AskedGap(limit_ms=8.0).bound_ms(2.0, 0.0) == 8.0 and str(AskedGap(wire=1.3)) == "1.3 x wire"


def test_the_gap_of_the_table_is_the_median_of_the_last_ones() -> None:
    gap = find_gap({"a.x": [(0, 10), (15, 20), (23, 30), (39, 45)], "b.x": [(0, 9), (14, 21), (24, 31), (40, 44)]})
    assert (gap.begin_ns, gap.end_ns, gap.start_ns) == (0, 10, 14)
    assert find_whole_ns([[(3, 5), (7, 9)], [(2, 4), (6, 11)]]) == 9


def test_a_row_tells_the_wire_from_the_frames_that_were_sent() -> None:
    row, exchanges = measure_virtual(FLEETS["1 SHRC-203, 100 ms"], STEPS)
    needed = {exchange.need: exchange for exchange in exchanges if exchange.need}
    assert list(needed) == ["end position", "target", "read-back", "begin"]
    assert needed["target"].out.startswith("MP:1") and needed["begin"].out == r"G:1\r\n"
    assert all(first.at_ms <= second.at_ms for first, second in pairwise(exchanges))
    # 38,400 baud, ten bits a character; 1.4 ms of the firmware an exchange. The reply to the begin is not waited for.
    characters = (
        sum(exchange.out_bytes + exchange.back_bytes for exchange in needed.values()) - needed["begin"].back_bytes
    )
    assert row.wire_ms == pytest.approx(characters / 3.84 + 4 * 1.4, abs=0.1)
    assert row.steps == STEPS and 0 < row.gap_ms <= row.gap_p99_ms and row.naive_ms > 0
    assert row.asked_ms == pytest.approx(max(1.5 * row.naive_ms, row.wire_ms + 3), abs=0.1)
    assert row.met == (row.gap_ms <= row.asked_ms) and set(row.field) == {"msl-equipment", "PyOptoSigma"}
    assert [line.split(":")[0] for line in list_sources([row])] == ["msl-equipment", "PyOptoSigma"]


def test_each_reply_belongs_to_the_line_before_it() -> None:
    row, exchanges = measure_virtual(FLEETS["1 SMC30, 400 ms"], STEPS)
    assert [exchange.out[1:6] for exchange in exchanges if exchange.need == "target"] == ["R509="]
    replies = {exchange.out[1:3]: exchange.back for exchange in exchanges if exchange.need}
    assert replies["V1"].startswith("V+") and replies["VR"].startswith("R509=") and replies["R5"].startswith("Y")
    assert row.wire_ms == pytest.approx(56, rel=0.05) and row.live_more_ms == 10.0


def test_what_is_asked_behind_the_begin_is_no_evidence_of_the_end() -> None:
    row, exchanges = measure_virtual(FLEETS["1 pp-electronic SMC, 140 ms"], STEPS)
    needed = [exchange for exchange in exchanges if exchange.need]
    assert [exchange.need for exchange in needed][-1] == "begin" and row.wire_ms == 75.0  # six lines of 12.5 ms
    assert {exchange.out[:2] for exchange in needed} == {"?s", "?p", "tb", "?t"}


def test_a_scan_is_timed_as_a_whole() -> None:
    scan = measure_scan(10)
    assert scan.points == 10 and scan.whole_s > 1.0 and scan.naive_s > 1.0
    assert scan.asked_s == pytest.approx(1.2 * scan.naive_s, abs=0.01) and scan.met == (scan.ratio <= 1.2)


def test_the_command_prints_rows_scan_scripts_and_exchanges(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "list_fleets", lambda: [FLEETS["1 SHRC-203, 100 ms"]])
    words = ["bench", "steps", "--steps", "10", "--scan-points", "10", "--virtual-only"]
    shown = CliRunner().invoke(main, [*words, "--exchanges"])
    assert shown.exit_code == 0, shown.output
    for text in ("1.5 x script or wire", "first start to last end", "msl-equipment: MSLNZ", "L469-591"):
        assert text in shown.output
    document = json.loads(CliRunner().invoke(main, [*words, "--json"]).stdout)
    assert document["exchanges"] is None and document["scan"]["points"] == 10
    assert document["rows"][0]["gap_p99_ms"] >= document["rows"][0]["gap_ms"]
