"""What a notebook shows of an object: short, and what a person looks for."""

import pytest

from orchestrator.client.api import Tutti
from orchestrator.client.blocking import BlockingTutti
from orchestrator.client.results import REPR_LENGTH, FleetStates, JobQueue, JobResult
from orchestrator.model.errors import TuttiError
from orchestrator.model.report import JobReport, QueueEntry, StepReport

HEAD = {"job_id": "j", "actor": "a", "epoch": 1, "submitted_utc": "2026-01-01T00:00:00Z", "max_start_skew_ns": 1}


def make_report(state: str, reason: str = "", name: str = "move") -> JobResult:
    step = StepReport(index=0, do="move", name="", state="done", actual_s=0.502, verdict="green")
    report = JobReport.model_validate({**HEAD, "name": name, "state": state, "reason": reason, "steps": [step]})
    return JobResult.of(report, ())


def test_results_say_what_became_of_them() -> None:
    assert repr(make_report("done")) == "<JobResult 'move' done, green, 0.502 s>"
    assert repr(make_report("aborted", "e-stop by anna")) == "<JobResult 'move' aborted, 0.502 s, e-stop by anna>"


def test_a_verdict_belongs_to_what_was_done() -> None:
    judged = [make_report(state).judge() for state in ("done", "aborted", "failed", "cancelled")]
    assert [report.verdict for report in judged] == ["green", None, None, None]
    assert judged[1].verdict_reason == "the job is aborted: a verdict belongs to what was done"


def test_long_ones_are_cut() -> None:
    entry = {"id": "i", "name": "n" * 100, "actor": "a", "state": "queued", "reason": "", "submitted_utc": "u"}
    queue = JobQueue(total=9, jobs=[QueueEntry.model_validate(entry)] * 9)
    for text in (repr(make_report("failed", "r" * 1000)), repr(queue)):
        assert len(text) <= REPR_LENGTH and text.endswith("…>")
    assert repr(FleetStates()) == "<FleetStates >"


def test_a_connection_shows_its_fleet_and_its_endpoint() -> None:
    assert repr(Tutti("tcp/127.0.0.1:7447", "demo", "anna")) == "<Tutti demo at tcp/127.0.0.1:7447, as anna>"
    assert "not connected" in repr(Tutti("tcp/127.0.0.1:7447"))


def test_a_notebook_connects_without_a_context() -> None:
    tutti = BlockingTutti("tcp/127.0.0.1:1")
    with pytest.raises(TuttiError, match="no router"):
        tutti.connect()
    tutti.close()
