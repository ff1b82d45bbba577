"""The bar of a script that waits: on a terminal, and nowhere else."""

import io
import sys

import pytest

from orchestrator.client.progress import show_bar
from orchestrator.model.report import JobProgress

RUNNING = JobProgress(
    job_id="1234abcd",
    name="scan",
    actor="test",
    state="running",
    step=2,
    steps=4,
    step_name="move",
    fraction=0.5,
    remaining_s=3.0,
    reason="",
    utc="2026-01-01T00:00:00Z",
)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_bar_shows_the_job_and_its_step_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    with show_bar(wanted=True) as receive:
        assert receive is not None
        receive(RUNNING)
    assert "1234abcd" in terminal.getvalue()
    assert "3.0 s left" in terminal.getvalue()


def test_a_pipe_gets_no_bar_and_a_script_that_asks_for_none_neither(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = io.StringIO()
    monkeypatch.setattr(sys, "stderr", pipe)
    with show_bar(wanted=True) as receive:
        assert receive is None
    monkeypatch.setattr(sys, "stderr", Terminal())
    with show_bar(wanted=False) as receive:
        assert receive is None
    assert pipe.getvalue() == ""
