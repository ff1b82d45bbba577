"""Without the library of PostgreSQL an address says what to install."""

from importlib.machinery import ModuleSpec

import pytest
from click.testing import CliRunner

from orchestrator.cli.base import extras
from orchestrator.cli.main import main
from orchestrator.coordinator.journal.postgres import opening
from orchestrator.coordinator.journal.records import JournalError

ADDRESS = "postgresql://tutti@127.0.0.1/lab"


def find_nothing(_: str) -> ModuleSpec | None:
    return None


@pytest.mark.parametrize("verb", ["check", "backup -o x", "export -o x"])
def test_a_command_says_what_to_install(verb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", find_nothing)
    result = CliRunner().invoke(main, ["journal", *verb.split(), "--journal", ADDRESS], prog_name="tutti")
    assert result.exit_code == 2
    assert "not installed: psycopg" in result.output and "pip install 'tutti[postgres]'" in result.output


def test_a_coordinator_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "find_spec", find_nothing)
    with pytest.raises(JournalError, match="psycopg, which is not installed") as caught:
        opening.open_journal(ADDRESS, "lab")
    assert "pip install 'tutti[postgres]'" in caught.value.remedy
