"""`tutti job ls` prints the names that users gave their jobs, with any characters."""

import pytest

from orchestrator.cli.jobs.history import print_jobs
from orchestrator.model.report import QueueEntry


def entry(name: str, reason: str = "", actor: str = "anna") -> QueueEntry:
    return QueueEntry(
        id="J-1", name=name, actor=actor, state="queued", reason=reason, submitted_utc="2026-11-22T09:30:00.000Z"
    )


@pytest.mark.parametrize("name", ["two\nlines", "a\u2028b", "[/x]", "[bold]loud", "tab\tbed", "a very long name " * 9])
@pytest.mark.parametrize("reason", ["", "waits for J-0", "because of [/y]"])
def test_a_name_is_one_row(name: str, reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    print_jobs([entry(name, reason), entry("next", actor=name)])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:3] == ["name", "job", "actor"]
    rows = [line for line in lines if "J-1" in line]
    assert len(rows) == 2
    assert len(lines) == 3 + bool(reason)
    assert rows[0].split()[0] == name.split()[0][: len(rows[0].split()[0])]
    assert not reason or reason in lines[2]


def test_no_jobs(capsys: pytest.CaptureFixture[str]) -> None:
    print_jobs([])
    assert capsys.readouterr().out.splitlines()[0].startswith("name")
