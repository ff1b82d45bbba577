"""Work spread over real processes."""

import json

import pytest
from click.testing import CliRunner

from orchestrator.cli.main import main
from orchestrator.lab.workers import spread

pytestmark = pytest.mark.live


def test_results_come_in_the_order_of_the_items() -> None:
    assert list(spread(abs, [-3, 1, -2], processes=2)) == list(spread(abs, [-3, 1, -2])) == [3, 1, 2]


def test_an_error_of_one_item_is_raised_and_ends_the_rest() -> None:
    with pytest.raises(ValueError, match="invalid literal"):
        list(spread(int, ["1", "nonsense", *["2"] * 1000], processes=2))


def test_two_processes_measure_what_one_does() -> None:
    asked = ["bench", "sync", "--trials", "5", "--only", "2 SMC-4000: clock, align 10 s", "--history", "5", "--json"]
    alone, both = [CliRunner().invoke(main, [*asked, "--processes", n]) for n in ("1", "2")]
    assert alone.exit_code == both.exit_code == 0, both.output
    assert json.loads(both.stdout) == json.loads(alone.stdout)
