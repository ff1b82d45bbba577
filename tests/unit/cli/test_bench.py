"""The commands that are made from the registries of benchmarks, those of users and those of developers."""

import json
from collections.abc import Callable

import pytest
from click.testing import CliRunner

from benches.__main__ import main as benches
from orchestrator.bench.dispatch import make_dispatch_fleet
from orchestrator.bench.estop import make_estop_fleet
from orchestrator.bench.registry.benchmarks import BENCHMARKS
from orchestrator.bench.registry.scale import LIVE_LABELS
from orchestrator.bench.scale_live import LiveScale
from orchestrator.cli.main import main
from orchestrator.model.fleet import Fleet


def test_a_benchmark_prints_its_tables_or_one_json_document() -> None:
    shown = CliRunner().invoke(benches, ["poll", "--seconds", "1"])
    assert shown.exit_code == 0, shown.output
    assert "SMC-2000 of two axes" in shown.output and "line limit" in shown.output
    found = json.loads(CliRunner().invoke(benches, ["poll", "--seconds", "1", "--json"]).stdout)
    assert found["seconds"] == 1 and {"units", "polls_s", "share"} < set(found["rows"][0])


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["lowering", "--make", "none"], "unknown make 'none'"),
        (["sync", "--only", "("], "is not a regular expression"),
        (["plan", "--rounds", "1"], "10<=x<=100000"),
    ],
)
def test_an_invalid_option_is_bad_input(words: list[str], text: str) -> None:
    shown = CliRunner().invoke(benches, words)
    assert shown.exit_code == 2 and text in shown.output


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["dispatch", "--rounds", "1"], "2<=x<=100000"),
        (["scale", "--live", "--controllers", "1"], "2<=x<=5000"),
        (["scale", "--live", "--hosts", "51"], "--hosts: 51 hosts for 50 controllers"),
        (["scale", "--controllers", "4", "--hosts", "5"], "--hosts: 5 hosts for 4 controllers"),
    ],
)
def test_an_invalid_option_of_a_users_benchmark_is_bad_input(words: list[str], text: str) -> None:
    shown = CliRunner().invoke(main, ["bench", *words])
    assert shown.exit_code == 2 and text in " ".join(shown.output.split())


def test_a_live_fleet_with_a_failed_job_a_refusal_an_alarm_or_a_loss_fails_the_scale_benchmark() -> None:
    live = LiveScale(**dict.fromkeys(LiveScale._fields, 0))
    assert not BENCHMARKS["scale"].has_failed({"live": live}) and not BENCHMARKS["scale"].has_failed({"live": None})
    for field in ("jobs_failed", "refusals", "alarms", "losses"):
        assert BENCHMARKS["scale"].has_failed({"live": live._replace(**{field: 1})})


def test_every_figure_of_a_live_fleet_is_shown_once() -> None:
    assert list(LIVE_LABELS) == list(LiveScale._fields)


def test_every_benchmark_has_its_command_in_its_example() -> None:
    for command in benches.commands.values():
        assert command.epilog and command.epilog.startswith(f"Example: python -m benches {command.name}")
    for benchmark in BENCHMARKS.values():
        assert benchmark.example.startswith(f"tutti bench {benchmark.name} ")


def test_a_lost_job_fails_the_kills_benchmark() -> None:
    found = {"lost": 0, "doubled": 0, "moved_on": 0}
    assert not BENCHMARKS["kills"].has_failed(found)
    assert BENCHMARKS["kills"].has_failed(found | {"lost": 1})


@pytest.mark.parametrize("make", [make_dispatch_fleet, make_estop_fleet])
def test_the_fleet_of_a_benchmark_is_valid_and_has_a_group_of_all_axes(make: Callable[[], Fleet]) -> None:
    fleet = make()
    assert fleet.expand_name("everything") == fleet.axis_names
