"""`tutti sim serve`: what it serves, and mistakes in its arguments."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from orchestrator.cli.main import main
from orchestrator.model.jobs.files import FileError, load_fleet
from orchestrator.runtime.live.served import describe_links, make_served_fleet, replace_links

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "name a MODEL, or a file with --fleet"),
        (["smc4000", "--fleet", "x.yaml"], "name a MODEL, or a file with --fleet"),
        (["smc400"], "no adapter 'smc400'; known adapters: ascii"),
        (["smc4000", "--options", "[1"], "not JSON"),
        (["smc4000", "--options", "[1]"], "must be a JSON object"),
        (["smc4000", "--options", '{"axs": 2}'], "fleet sim-smc4000: controllers.smc4000.simulate.options.axs"),
        (["cia402", "--link", "tcp"], "slcan"),
        (["smc4000", "--number", "0"], "--number"),
        (["--fleet", "nope.yaml"], "nope.yaml:1: cannot be read"),
        (["--fleet", str(EXAMPLES / "demo.fleet.yaml"), "--number", "2"], "need a MODEL"),
        (["smc4000", "--link", "pigeon"], "pigeon"),
    ],
)
def test_a_mistake_in_the_arguments_has_its_message(arguments: list[str], said: str) -> None:
    done = CliRunner().invoke(main, ["sim", "serve", *arguments])
    assert done.exit_code == 2 and said in done.stderr, done.output + done.stderr


def test_controllers_of_a_make_that_can_share_a_line_are_on_one() -> None:
    (link,) = describe_links(make_served_fleet("smc30", 3, {}))
    assert [each["address"] for each in link["controllers"]] == [1, 2, 3] and link["baud"] == 9600
    assert len(describe_links(replace_links(make_served_fleet("smc30", 3, {}), "tcp"))) == 3
    assert len(describe_links(make_served_fleet("smc4000", 2, {}))) == 2


@pytest.mark.parametrize("model", ["smc4000", "smc2000", "shrc203", "ppsmc", "smc30", "galil"])
@pytest.mark.parametrize("kind", ["tcp", "udp", "serial"])
def test_every_model_is_put_on_the_wanted_kind_of_link(model: str, kind: str) -> None:
    fleet = replace_links(make_served_fleet(model, 2, {}), kind)  # type: ignore[arg-type]
    links = describe_links(fleet)
    assert [link["kind"] for link in links] == [kind, kind]
    assert all(each["address"] is None for link in links for each in link["controllers"])


def test_options_of_the_simulator_are_added_and_checked() -> None:
    fleet = make_served_fleet("smc4000", 1, {"travel": {"X": [-5, 5]}})
    assert fleet.controllers["smc4000"].simulate.options["travel"] == {"X": [-5, 5]}
    with pytest.raises(FileError, match="travel"):
        make_served_fleet("smc4000", 1, {"travel": 3})


def test_a_fleet_file_keeps_its_links() -> None:
    links = describe_links(load_fleet(EXAMPLES / "demo.fleet.yaml"))
    assert [link["kind"] for link in links] == ["tcp", "serial"]
