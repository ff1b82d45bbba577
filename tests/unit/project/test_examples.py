"""The example files are found in the checkout, and an installation without them says so."""

from importlib import metadata
from pathlib import Path

import pytest

from orchestrator.runtime import examples


def test_examples_are_found_in_the_checkout() -> None:
    assert examples.find_example("demo.fleet.yaml").is_file()


def test_an_installation_is_searched_by_its_own_list_of_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(examples, "_CHECKOUT", tmp_path / "none")
    installed = metadata.PackagePath("../../../share/tutti/examples/demo.fleet.yaml")
    installed.dist = metadata.distribution("pytest")
    monkeypatch.setattr(metadata, "files", lambda _: [metadata.PackagePath("other"), installed])
    assert examples.find_example("demo.fleet.yaml").parts[-3:] == ("tutti", "examples", "demo.fleet.yaml")
    with pytest.raises(examples.ExamplesMissing, match=r"no example x\.yaml; install it again"):
        examples.find_example("x.yaml")
