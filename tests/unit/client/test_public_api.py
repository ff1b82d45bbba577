"""The public Python interface: what it loads, what it documents, and that both forms of it are the same."""

import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import tutti
from orchestrator.client.blocking import BlockingTutti
from orchestrator.model.jobs.files import FileError, parse_document
from tutti import Dwell, Home, Job, Move, Tutti

ROOT = Path(__file__).parents[3]
HEAVY = (
    *("zenoh", "ruckig", "numpy", "matplotlib", "rich", "canopen", "can", "serial", "adapters", "sim"),
    *("orchestrator.coordinator", "orchestrator.monitor", "orchestrator.runtime", "orchestrator.plan"),
)
NOT_OF_USERS = {
    "bus",
    "keys",
    "open",
    "request_fields",
    "request_service",
    "request_controller",
    "subscribe_samples",
    "follow_all",
}
INTERNAL = {"find_absence", "show_job_when_available", "load_result", "read_point_parts"}


def test_importing_it_loads_nothing_heavy() -> None:
    code = f"import tutti, sys; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", tutti.__all__)
def test_every_public_name_is_documented(name: str) -> None:
    found = getattr(tutti, name)
    if name == "Step":
        return  # a union
    assert inspect.getdoc(found)
    members = inspect.getmembers(found, lambda each: inspect.isroutine(each) or isinstance(each, property))
    for part, value in members if inspect.isclass(found) else []:
        function = value.fget if isinstance(value, property) else value
        if not part.startswith("_") and (getattr(function, "__module__", "") or "").startswith(
            ("orchestrator", "tutti")
        ):
            assert inspect.getdoc(value), f"{name}.{part} has no docstring"


@pytest.mark.structure
def test_the_blocking_interface_is_up_to_date() -> None:
    done = subprocess.run(
        [sys.executable, "tools/blocking_client.py", "--check"], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr


def test_the_blocking_interface_has_every_method_with_its_signature_and_docstring() -> None:
    names = {name for name, _ in inspect.getmembers(Tutti, callable) if not name.startswith("_")}
    for name in sorted(names - NOT_OF_USERS - INTERNAL - {"close"}):
        blocking, waiting = getattr(BlockingTutti, name), getattr(Tutti, name)
        assert list(inspect.signature(blocking).parameters) == list(inspect.signature(waiting).parameters), name
        assert inspect.getdoc(blocking), name


def test_a_job_is_made_without_ceremony() -> None:
    steps = [Home(), Move(to={"gantry.x": 120, "stage.u": "6 mm"}), Dwell(duration="1.5 s")]
    job = Job("scan", steps, max_start_skew="5 ms")
    assert job == Job(name="scan", steps=steps, max_start_skew="5 ms")
    assert Job.model_validate_json(job.to_json()) == job
    assert (job.max_start_skew, job.steps[2]) == (5_000_000, steps[2])
    assert steps[2].to_plain() == {"do": "dwell", "duration": "1500000000 ns", "name": None}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("name: x\nsteps: [{do: home}]\n", "f:1: schema: is missing"),
        ("schema: tutti.job/1\nname: x\nsteps: [{to: {a.b: 1}}]\n", "f:3: steps[0]: needs the field 'do'"),
        ("name: x\n", "f:1: schema: is missing\nf:1: steps: is missing"),
    ],
)
def test_a_file_still_needs_its_schema_and_the_kind_of_each_step(text: str, problem: str) -> None:
    with pytest.raises(FileError) as error:
        parse_document(text, Job, "f")
    assert problem in str(error.value)


def test_the_json_schema_of_a_job_file_still_requires_them() -> None:
    schema = Job.model_json_schema(by_alias=True)
    assert schema["required"] == ["schema", "name", "steps"]
    assert all("do" in schema["$defs"][step]["required"] for step in ("Home", "Move", "Dwell", "WaitInput"))


def test_a_script_that_does_not_catch_a_refusal_shows_what_to_do() -> None:
    code = "from tutti import Refusal; raise Refusal('busy', 'gantry.x is in use', 'wait for its end')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.stderr.splitlines()[-2:] == [
        "orchestrator.model.errors.Refusal: gantry.x is in use",
        "wait for its end",
    ]
