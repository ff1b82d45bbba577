"""`tutti adapter …`: a new package, its check, the list of plug-ins, and a look at a controller."""

import importlib
import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from adapters.host.makes import find_make
from orchestrator.cli.main import main
from orchestrator.conformance import suite
from orchestrator.conformance.findings import ContractBroken
from orchestrator.conformance.suite import MakeCheck, list_checks, run_check
from orchestrator.runtime.probe import BadProbe, parse_probe_endpoint, parse_probe_query
from sim.core.vectors import find_simulator

ACME = Path(__file__).parents[3] / "deploy" / "examples" / "adapter-acme"
Install = Callable[[str, Path], None]


def run(*words: str) -> Result:
    return CliRunner().invoke(main, list(words), env={"COLUMNS": "200"})


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """A package of a make as `pip install -e` makes it known."""

    def add(name: str, folder: Path) -> None:
        monkeypatch.syspath_prepend(folder)
        known = tmp_path / "site"
        metadata = known / f"tutti_{name}-0.1.0.dist-info"
        metadata.mkdir(parents=True)
        monkeypatch.syspath_prepend(known)
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: tutti-{name}\nVersion: 0.1.0\n")
        points = f"[tutti.adapters]\n{name} = {name}_adapter:MAKE\n"
        points += f"[tutti.simulators]\n{name} = {name}_simulator:{name.upper()}\n"
        (metadata / "entry_points.txt").write_text(points)
        importlib.invalidate_caches()

    yield add
    for cached in (find_make, find_simulator):
        cached.cache_clear()
    for module in [each for each in sys.modules if each.startswith(("acme_", "mc2000_"))]:
        del sys.modules[module]


@pytest.mark.nightly
def test_a_new_package_passes_the_whole_suite(install: Install, tmp_path: Path) -> None:
    folder = tmp_path / "src"
    made = run("adapter", "new", "mc2000", "--into", str(folder))
    assert made.exit_code == 0, made.output
    assert "pip install --no-build-isolation -e" in made.output
    assert not [file for file in folder.rglob("*") if file.is_file() and "acme" in file.read_text().lower()]
    install("mc2000", folder)
    checked = run("adapter", "check", "tutti-mc2000", "--json")
    assert checked.exit_code == 0, checked.output
    found = json.loads(checked.output)["makes"]["mc2000"]
    assert {each["part"] for each in found} >= {"contract", "power cuts", "replies", "vectors"}
    assert sum(each["state"] == "holds" for each in found) >= 40
    listed = run("adapter", "ls", "--json")
    assert ("mc2000", "tutti-mc2000 0.1.0") in [
        (e["name"], e["package"]) for e in json.loads(listed.output)["plug_ins"]
    ]


def test_the_example_outside_the_tree_passes_the_whole_suite(install: Install) -> None:
    install("acme", ACME)
    # The campaign has checked its copy, above.
    checks = [each for each in list_checks("acme") if each.part != "campaign"]
    assert not [each for each in map(run_check, checks) if each.state == "broken"]


@pytest.mark.parametrize(
    ("file", "good", "bad", "words"),
    [
        ("dialect.py", '"idle" if found[1] == "IDLE" else "moving"', '"idle"', "a step ended as fault"),
        ("dialect.py", "float(at), moving", "float(at) + 1, moving", "a step ended as fault"),
    ],
)
def test_a_mistake_of_a_make_is_found(
    install: Install, tmp_path: Path, file: str, good: str, bad: str, words: str
) -> None:
    folder = tmp_path / "acme"
    shutil.copytree(ACME, folder)
    path = folder / "acme_adapter" / file
    text = path.read_text()
    assert good in text
    path.write_text(text.replace(good, bad))
    install("acme", folder)
    results = (run_check(each) for each in list_checks("acme") if each.part == "contract")
    assert any(each.state == "broken" and words in each.text for each in results)


def test_what_does_not_hold_is_printed_and_exits_with_1(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise ContractBroken("an axis still moves")

    checks = [MakeCheck("contract", "a stop stops", fail), MakeCheck("contract", "it connects", lambda: None)]
    monkeypatch.setattr(suite, "list_checks", lambda *_, **__: checks)
    checked = run("adapter", "check", "smc30")
    assert checked.exit_code == 1
    assert "BROKEN  contract: a stop stops" in checked.output and "an axis still moves" in checked.output
    assert "smc30: 1 hold, 1 do not, 0 do not apply" in checked.output
    as_json = run("adapter", "check", "smc30", "--json")
    assert as_json.exit_code == 1 and json.loads(as_json.output)["broken"] == 1


def test_an_example_that_its_make_refuses_is_named(install: Install, tmp_path: Path) -> None:
    folder = tmp_path / "acme"
    shutil.copytree(ACME, folder)
    path = folder / "acme_adapter" / "make.py"
    path.write_text(path.read_text().replace("motors: [X]", "motors: [Z]"))
    install("acme", folder)
    checked = run("adapter", "check", "acme")
    assert checked.exit_code == 1 and "does not pass check_config" in checked.output


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Acme", "cannot be the name of a make"),
        ("1a", "cannot be the name of a make"),
        ("class", "cannot be the name of a make"),
        ("smc30", "the make smc30 exists already"),
        ("json", "is a module of Python itself"),
        ("../x", "cannot be the name of a make"),
    ],
)
def test_a_bad_name_is_refused(name: str, words: str) -> None:
    made = run("adapter", "new", name)
    assert made.exit_code == 2
    assert words in made.output


def test_an_existing_folder_is_not_written_over(tmp_path: Path) -> None:
    made = run("adapter", "new", "mc2000", "--into", str(tmp_path))
    assert made.exit_code == 2
    assert "exists already" in made.output and "--into" in made.output


def test_unknown_makes_and_packages_are_bad_input() -> None:
    unknown = run("adapter", "check", "no-such")
    assert unknown.exit_code == 2 and "known adapters" in unknown.output
    other = run("adapter", "check", "pytest")
    assert other.exit_code == 2 and "provides no adapter" in other.output


def test_endpoints_and_queries_of_probes() -> None:
    assert parse_probe_endpoint("tcp:10.0.0.1:23").endpoint == "tcp 10.0.0.1:23"
    serial = parse_probe_endpoint("/dev/ttyS0,9600,7O1")
    assert serial.kind == "serial" and (serial.baud, serial.data_bits, serial.parity) == (9600, 7, "odd")
    assert parse_probe_query(r"?\x18\r\n\\") == b"?\x18\r\n\\"
    for endpoint in ("tcp:x", "tcp:x:0", "tcp:x:99999", "nonsense", "/dev/ttyS0,9600,9X1"):
        with pytest.raises(BadProbe, match="is no endpoint"):
            parse_probe_endpoint(endpoint)
    for query in (r"\q", "\\", "€"):
        with pytest.raises(BadProbe):
            parse_probe_query(query)
    silent = run("adapter", "probe", "tcp:127.0.0.1:1", "?", "--json")
    assert silent.exit_code == 3, silent.output
