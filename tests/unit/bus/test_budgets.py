"""What a message may have is counted before it is decoded, and the first of very many mistakes is found cheaply."""

import inspect
import json
import time

import pytest
from pydantic import ValidationError

from adapters.controller.commands import ControllerCommands
from orchestrator.bus.base import BusSample, RequestRefused
from orchestrator.bus.budgets import (
    COMMAND_BUDGETS,
    JOB,
    MOTION,
    NAMES,
    QUERY,
    SERVICE_BUDGETS,
    STOP,
    USUAL,
    find_most_bytes,
    find_request_budget,
    is_estop_key,
)
from orchestrator.bus.decoding import read_request
from orchestrator.bus.limits import MAX_COORDINATOR_MESSAGE_BYTES, MAX_HOST_MESSAGE_BYTES
from orchestrator.bus.service_verbs import CONTROLLER_VERBS, SERVICE_VERBS
from orchestrator.model.jobs.files import validate_part
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.service import SubmitJob
from orchestrator.model.messages import LeaseRequest, Request, TraceRequest
from orchestrator.model.problems import MAX_DESCRIBED, read_problems

FLEET = "tutti/v1/demo"


def refusal(model: type[Request] | type[TraceRequest], key: str, payload: bytes) -> str:
    with pytest.raises(RequestRefused) as refused:
        read_request(model, BusSample(f"{FLEET}/{key}", payload), "verb: ")
    return str(refused.value)


def test_each_row_is_of_a_verb() -> None:
    assert set(SERVICE_BUDGETS) <= set(SERVICE_VERBS)
    assert set(CONTROLLER_VERBS) <= set(COMMAND_BUDGETS) | {"forget"}
    source = inspect.getsource(ControllerCommands.__init__)
    assert [verb for verb in COMMAND_BUDGETS if f'"{verb}": (' not in source] == []


def test_no_budget_is_beyond_what_its_process_takes() -> None:
    assert max(budget.max_bytes for budget in SERVICE_BUDGETS.values()) <= MAX_COORDINATOR_MESSAGE_BYTES
    assert max(budget.max_bytes for budget in COMMAND_BUDGETS.values()) <= MAX_HOST_MESSAGE_BYTES


@pytest.mark.parametrize(
    ("key", "budget"),
    [
        ("svc/submit", JOB),
        ("svc/names", USUAL),
        ("svc/no-such", USUAL),
        ("svc/hold", NAMES),
        ("ctl/gantry/cmd/arm", MOTION),
        ("ctl/gantry/cmd/stop", STOP),
        ("ctl/gantry/cmd/go", USUAL),
        ("host/lab/cmd/arm", MOTION),
        ("host/lab/cmd/go", NAMES),
        ("ctl/gantry/trace", QUERY),
        ("ctl/gantry/state", QUERY),
        ("leads/abc", QUERY),
        ("time", QUERY),
    ],
)
def test_a_request_has_the_budget_of_its_key(key: str, budget: object) -> None:
    assert find_request_budget(f"{FLEET}/{key}") is budget


def test_a_key_that_is_of_no_fleet_has_only_the_limit_of_the_process() -> None:
    for kind in ("request", "sample", "answer"):
        assert find_most_bytes(kind, "another/program", 7) == 7


def test_a_process_with_a_smaller_limit_keeps_it() -> None:
    assert find_most_bytes("request", f"{FLEET}/svc/submit", 100) == 100
    assert find_most_bytes("sample", f"{FLEET}/ctl/gantry/state", 100) == 100


def test_states_are_bounded_and_reports_are_not() -> None:
    assert find_most_bytes("sample", f"{FLEET}/ctl/gantry/state", 10**9) == 256_000
    assert find_most_bytes("sample", f"{FLEET}/leader", 10**9) == 16_000
    assert find_most_bytes("sample", f"{FLEET}/lease/gantry/x", 10**9) == 16_000
    assert find_most_bytes("sample", f"{FLEET}/job/j/report", 10**9) == 10**9
    assert find_most_bytes("answer", f"{FLEET}/ctl/gantry/cmd/go", 10**9) == 1_000_000
    assert find_most_bytes("answer", f"{FLEET}/host/lab/cmd/take-triggers", 10**9) == 10**9
    assert find_most_bytes("answer", f"{FLEET}/svc/show", 10**9) == 10**9


def test_only_the_key_of_the_estop_is_one() -> None:
    assert is_estop_key(f"{FLEET}/estop") and is_estop_key("tutti/v1/*/estop")
    assert not is_estop_key(f"{FLEET}/estop-reset") and not is_estop_key(f"{FLEET}/ctl/estop/state")


def test_a_refusal_names_limit_size_and_remedy() -> None:
    text = refusal(TraceRequest, "ctl/gantry/trace", b" " * 1_001)
    assert text.startswith("verb: too large: a request has at most 1000 bytes here, this one 1001; ")
    assert "send only the fields" in text


def test_fields_and_values_are_counted() -> None:
    many_fields = json.dumps({str(number): 0 for number in range(20_001)}).encode()
    assert "at most 20000 fields here, this one 20001" in refusal(LeaseRequest, "svc/hold", many_fields)
    many_values = json.dumps({"axes": [0] * 20_002}).encode()
    assert "at most 20000 values here, this one 20001" in refusal(LeaseRequest, "svc/hold", many_values)


def test_the_first_of_very_many_mistakes_is_named_without_describing_them() -> None:
    count = 100_000
    payload = json.dumps({"job": 5} | {f"x{number}": 0 for number in range(count)}).encode()
    began_s = time.process_time()
    text = refusal(SubmitJob, "svc/submit", payload)
    took_s = time.process_time() - began_s
    assert text.startswith(f"verb: request_id: Field required (and {count + 3} mistakes more)")
    with pytest.raises(ValidationError) as error:
        SubmitJob.model_validate_json(payload)
    began_s = time.process_time()
    error.value.errors()
    # It took longer to describe all of them than everything takes now.
    assert took_s < 3 * (time.process_time() - began_s)


def test_mistakes_beyond_the_beginnings_are_counted() -> None:
    text = refusal(LeaseRequest, "svc/hold", json.dumps({"axes": ["x"] * 100 + [0] * 5_000}).encode())
    assert "request_id: Field required" in text
    good = {"request_id": "r", "actor": "a", "epoch": 1, "coordinator": "c", "holder": "h", "ttl_ms": 0}
    text = refusal(LeaseRequest, "svc/hold", json.dumps({**good, "axes": ["x"] * 100 + [0] * 5_000}).encode())
    assert "has 5000 mistakes, of which at most 1000 are listed" in text


def test_a_file_with_very_many_mistakes_names_the_first_ones() -> None:
    value = {"schema": "tutti.job/1", "name": "n", "steps": [{"do": "dwell", "duration": "1 s", "x": 0}] * 1_500}
    job, problems = validate_part(value, Job)
    assert job is None and len(problems) == MAX_DESCRIBED + 1
    assert problems[0].field == "steps.0.dwell.x"
    assert problems[-1].text.startswith("has 1500 mistakes")


def test_few_mistakes_are_all_described() -> None:
    with pytest.raises(ValidationError) as error:
        Request.model_validate_json('{"x": 0}')
    assert [problem.field for problem in read_problems(error.value)] == ["request_id", "actor", "x"]
