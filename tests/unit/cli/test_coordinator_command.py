"""`tutti coordinator` with arguments that it cannot use: one line with a remedy, nothing is started."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from orchestrator.cli.base import extras
from orchestrator.cli.main import main

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "demo.fleet.yaml"
ADDRESS = "postgresql://tutti@a,b/tutti"


def refuse(folder: Path, journal: str = ADDRESS, file: Path = EXAMPLE, connect: str = "tcp/127.0.0.1:1") -> str:
    """The error of a command that ends with exit code 2."""
    words = ["coordinator", str(file), "--journal", journal, "--connect", connect, "--state", str(folder / "state")]
    result = CliRunner().invoke(main, words, prog_name="tutti")
    assert result.exit_code == 2 and not result.stdout, result.output
    assert not (folder / "state").exists()
    assert len(result.stderr.splitlines()) <= 2  # a problem, and its remedy
    return result.stderr


def test_an_address_that_is_none(tmp_path: Path) -> None:
    pytest.importorskip("psycopg")
    assert "a file is for `tutti up`" in refuse(tmp_path, "lab.db")
    for journal, problem in (
        ("postgresql://tutti:secret@a:port/tutti", "its port is 'port'"),
        ("postgresql://tutti:secret@a", "its scheme or its database is missing"),
        ("postgresql://tutti:secret@a/tutti?option", "it is no address of a PostgreSQL database"),
    ):
        shown = refuse(tmp_path, journal)
        assert problem in shown and "postgresql://USER@HOST,HOST/DATABASE" in shown and "secret" not in shown


def test_a_file_that_is_missing_and_an_endpoint_that_is_none(tmp_path: Path) -> None:
    pytest.importorskip("psycopg")
    assert "none.yaml:1: cannot be read" in refuse(tmp_path, file=tmp_path / "none.yaml")
    assert "is not an endpoint" in refuse(tmp_path, connect="nonsense")


def test_without_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    assert "pip install 'tutti[postgres]'" in refuse(tmp_path)
