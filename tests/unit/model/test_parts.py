"""Large jobs in parts: the same value, and the same JSON, as at once."""

import pickle
from typing import Any

import pytest

from orchestrator.bus.base import BusSample
from orchestrator.bus.decoding import read_request_parts
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.parts import dump_long, has_long_path, join_value, split_value
from orchestrator.model.jobs.service import SubmitJob
from orchestrator.model.paths.packed import PART_ITEMS


def make_job(pieces: int, repeats: int = 1) -> Job:
    lines = [{"piece": "line", "to": [f"{number % 7} mm", number % 3], "speed": "2 mm/s"} for number in range(pieces)]
    path = {"do": "path", "axes": ["gantry.x", "gantry.y"], "start": [0, 0], "speed": "10 mm/s", "tolerance": "10 um"}
    path["pieces"] = [*lines, {"piece": "arc", "to": [1, 1], "centre": [0, 1]}]
    inner = {"do": "repeat", "times": 2, "steps": [path, {"do": "dwell", "duration": "1 s"}]}
    return Job.model_validate({"schema": "tutti.job/1", "name": "p", "steps": [path, inner][:repeats]})


def join(parts: list[bytes]) -> tuple[Any, int]:
    work, turns = join_value(parts), 0
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value, turns
        turns += 1


@pytest.mark.parametrize("steps", [3, PART_ITEMS, 3 * PART_ITEMS + 1])
def test_a_job_in_parts_is_the_same_job(steps: int) -> None:
    dwells = [{"do": "dwell", "duration": f"{number + 1} ms"} for number in range(steps)]
    job = Job.model_validate({"schema": "tutti.job/1", "name": "p", "steps": dwells})
    value, turns = join(split_value(job))
    assert value == job
    assert turns == 1 + (-(-steps // PART_ITEMS) if steps > PART_ITEMS else 0)


@pytest.mark.parametrize("pieces", [3, 3 * PART_ITEMS + 1])
def test_a_job_is_written_as_at_once(pieces: int) -> None:
    job = make_job(pieces, repeats=2)
    request = SubmitJob(request_id="r", actor="a", client_key="k", job=job)
    assert has_long_path(request) == (pieces > PART_ITEMS)
    assert dump_long(job) == job.to_json()
    assert dump_long(request) == request.to_json()
    left_out = {"request_id": True, "job": {"actor"}}
    assert dump_long(request, left_out) == request.model_dump_json(exclude=left_out).encode()


def test_a_request_with_long_paths_is_read_in_parts() -> None:
    request = SubmitJob(request_id="r", actor="a", client_key="k", job=make_job(2 * PART_ITEMS, repeats=2))
    sample = BusSample("tutti/v1/demo/svc/submit", request.to_json())
    value, turns = join(read_request_parts(SubmitJob, sample, "submit: "))
    assert value == request and turns == 1  # the pieces stay packed


def test_a_refusal_passes_between_processes() -> None:
    refusal = pickle.loads(pickle.dumps(Refusal("code", "text", "remedy", "gantry")))
    assert (refusal.code, refusal.text, refusal.remedy, refusal.controller) == ("code", "text", "remedy", "gantry")
