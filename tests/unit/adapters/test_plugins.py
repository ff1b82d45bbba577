"""Plug-ins of installed packages: broken, of another version, twice the same; and what they affect."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from adapters.contract import ExamplePlace
from adapters.host.makes import find_controller_problems, find_make, known_makes, list_makes, stops_by_line
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.axis_units import SoftLimits
from orchestrator.model.fleet import Axis, Controller, Fleet
from orchestrator.model.plugins import API_VERSION, PluginError, UnknownPlugin
from orchestrator.runtime.checked import load_checked_fleet
from orchestrator.runtime.example_fleet import load_example
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.vectors import find_simulator

Install = Callable[..., None]
MAKE = """
from adapters.smc30.make import Smc30Make
class Make(Smc30Make):
    {line}
MAKE = Make()
"""
PARTS = {
    "link": {"kind": "tcp", "host": "127.0.0.1", "port": 1},
    "axes": {"z": {"motors": ["1"], "unit": "mm", "limits": {"velocity": 1, "acceleration": 1}}},
}


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """A package as pip installs it: a module, and the metadata that names its entry point."""
    monkeypatch.syspath_prepend(tmp_path)

    def add(package: str, text: str, group: str = "tutti.adapters", name: str = "broken") -> None:
        (tmp_path / f"{package}.py").write_text(text)
        monkeypatch.delitem(sys.modules, package, raising=False)
        metadata = tmp_path / f"{package}-2.5.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 2.5\n")
        (metadata / "entry_points.txt").write_text(f"[{group}]\n{name} = {package}:MAKE\n")

    return add


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import no_such_module", "cannot be imported: ModuleNotFoundError: No module named 'no_such_module'"),
        ("raise SystemExit('closed')", "cannot be imported: SystemExit: closed"),
        ("x = 1", "AttributeError"),
        ("syntax error", "SyntaxError"),
        ("MAKE = object()", "has no name, options_model, check_config"),
        (MAKE.format(line="api_version = 0"), "install a newer release of acme_kit"),
        (
            MAKE.format(line=f"api_version = {API_VERSION + 1}"),
            "install a newer Tutti, or an older release of acme_kit",
        ),
        (MAKE.format(line="api_version = '1.0'"), "api_version is '1.0'; it must be a whole number"),
    ],
)
def test_a_plug_in_that_cannot_be_used_is_named_with_package_place_and_remedy(
    install: Install, text: str, words: str
) -> None:
    install("acme_kit", text)
    with pytest.raises(PluginError) as caught:
        find_make("broken")
    assert words in str(caught.value)
    assert "adapter broken of package acme_kit 2.5 (entry point acme_kit:MAKE)" in str(caught.value)
    assert caught.value.remedy
    (listing,) = [each for each in list_makes() if each.problem]
    assert (listing.name, listing.package) == ("broken", "acme_kit 2.5")
    # Nothing else is affected.
    assert find_make("smc30").name == "smc30" and "broken" in known_makes()


def test_a_version_of_the_contract_that_is_this_one_or_absent_is_accepted(install: Install) -> None:
    install("acme_one", MAKE.format(line=f"api_version = {API_VERSION}"), name="one")
    install("acme_two", MAKE.format(line="pass"), name="two")
    assert find_make("one") and find_make("two")


def test_two_packages_of_one_name_are_both_named(install: Install) -> None:
    install("acme_left", MAKE.format(line="pass"))
    install("acme_right", MAKE.format(line="pass"))
    with pytest.raises(PluginError, match=r"acme_left 2\.5 and acme_right 2\.5; uninstall all but one"):
        find_make("broken")
    assert len([each for each in list_makes() if each.problem]) == 2


def test_a_simulator_is_checked_alike(install: Install) -> None:
    install("acme_sim", "class S:\n    api_version = 99\nMAKE = S()", "tutti.simulators", "broken")
    with pytest.raises(PluginError, match=r"simulator broken of package acme_sim 2\.5 .*version 99"):
        find_simulator("broken")
    with pytest.raises(UnknownPlugin, match=r"no simulator 'none'; known models: .*broken"):
        find_simulator("none")


def test_only_the_controllers_of_a_broken_plug_in_are_affected(install: Install, tmp_path: Path) -> None:
    install("acme_kit", "import no_such_module")
    file = tmp_path / "lab.fleet.yaml"
    smc30 = find_make("smc30").fleet_example
    own = "".join(f"    {line}\n" for line in smc30(ExamplePlace(0, 0)).splitlines())
    broken = own.replace("adapter: smc30", "adapter: broken").replace("ttyUSB0", "ttyUSB9")
    file.write_text(f"schema: tutti.fleet/1\nfleet: lab\ncontrollers:\n  a:\n{own}  b:\n{broken}")
    with pytest.raises(ValueError, match=r"lab\.fleet\.yaml:\d+: .*no_such_module"):
        load_checked_fleet(file)
    fleet = load_checked_fleet(file, tolerant=True)
    assert [names for names, _ in stops_by_line(fleet.controllers)] == [["a"]]


def test_an_unknown_make_is_a_mistake_of_the_file_in_any_case() -> None:
    config = Controller.model_validate({"adapter": "none", **PARTS})
    for tolerant in (False, True):
        (problem,) = find_controller_problems("x", config, tolerant=tolerant)
        assert "no adapter 'none'; known adapters: " in problem.text


def test_other_controllers_of_the_host_run_and_the_broken_one_shows_the_reason(install: Install) -> None:
    install("acme_kit", "import no_such_module")
    install("acme_sim", "from sim.smc30 import SMC30 as MAKE", "tutti.simulators")
    axis = {"motors": ["1"], "unit": "mm", "scale": 400, "limits": {"velocity": 10, "acceleration": 50}}
    link = {"kind": "serial", "baud": 9600, "data_bits": 7, "parity": "odd"}
    controllers = {
        name: {"adapter": adapter, "link": {**link, "device": f"/dev/{name}"}, "axes": {"z": axis}}
        for name, adapter in (("good", "smc30"), ("bad", "broken"))
    }
    fleet = Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "lab", "controllers": controllers})

    async def main(clock: VirtualClock) -> None:
        virtual = VirtualFleet(fleet, clock, 1)
        with pytest.raises(TimeoutError):  # it waits for all controllers
            await virtual.start()
        client = virtual.make_client("looker")
        states = await client.status(1.0)
        assert states["good"].mode != "offline"
        assert states["bad"].mode == "offline"
        (fault,) = states["bad"].faults
        assert "acme_kit 2.5" in fault.text and "no_such_module" in fault.text and fault.remedy

    run_virtual(main)


@pytest.mark.parametrize(
    ("adapter", "direction", "low", "high", "is_wrong"),
    [
        ("ascii", "positive", 0, 180, True),
        ("ascii", "positive", 5, 180, True),
        ("ascii", "positive", -180, 0, False),
        ("ascii", "positive", -180, 5, False),
        ("ascii", "negative", -180, 0, True),
        ("ascii", "negative", 0, 180, False),
        ("ascii", "negative", 5, 180, False),  # it keeps off the switch
        ("smc30", "positive", 0, 100, True),
        ("shrc203", "positive", 0, 50, False),  # its direction is set in the controller
    ],
)
def test_soft_limits_beyond_the_home_switch_are_named(
    adapter: str, direction: str, low: float, high: float, is_wrong: bool
) -> None:
    config = load_example(adapter)
    name, axis = next(iter(config.axes.items()))
    plain = axis.model_dump(mode="json", by_alias=True, exclude_unset=True)
    plain |= {"soft_limits": {"min": low, "max": high}, "homing": {"direction": direction}}
    changed = config.model_copy(update={"axes": {name: Axis.model_validate(plain)}})
    problems = [problem for problem in find_controller_problems("c", changed) if "home switch" in problem.text]
    assert bool(problems) == is_wrong
    for problem in problems:
        assert problem.place == ("controllers", "c", "axes", name, "soft_limits")
        assert f"{low} to {high} lies beyond" in problem.text
        assert "homing: {direction: " in problem.text


def test_an_axis_that_can_turn_past_its_switch_has_no_far_side() -> None:
    config = load_example("ppsmc")  # in degrees
    axes = {
        name: axis.model_copy(update={"soft_limits": SoftLimits(min=-90, max=0)}) for name, axis in config.axes.items()
    }
    problems = find_controller_problems("c", config.model_copy(update={"axes": axes}))
    assert not [problem for problem in problems if "home switch" in problem.text]
