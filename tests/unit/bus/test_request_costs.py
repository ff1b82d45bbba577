"""What a process does with the worst message that it reads in its loop: bounded in time, whatever the message has."""

import inspect
import re
import time
from collections.abc import Iterator

import pytest

import adapters.controller.commands as commands_module
from adapters.controller.commands import ControllerCommands
from orchestrator.bus.base import BusSample, RequestRefused
from orchestrator.bus.budgets import find_request_budget
from orchestrator.bus.decoding import MAX_AT_ONCE, read_request
from orchestrator.bus.service_verbs import SERVICE_VERBS
from orchestrator.model.messages import BatchRequest, Request, TraceRequest

# A busy computer of CI takes three times as long as an idle one: of 50 ms in a host, and 100 ms in a coordinator.
HOST_S, COORDINATOR_S = 0.15, 0.3


def list_bodies(size: int, names: list[str]) -> Iterator[tuple[str, bytes]]:
    """Bodies of at most `size` bytes that take long for their size."""
    yield "unknown fields", b"{%s}" % b",".join(b'"x%d":0' % number for number in range(max(1, size // 13)))
    for name in names:
        room = size - len(name) - 20
        for what, item in (("numbers", b"0"), ("texts", b'"a"'), ("objects", b'{"x":0}'), ("empty objects", b"{}")):
            yield f"{name}: {what}", b'{"%s":[%s]}' % (name.encode(), b",".join([item] * (room // (len(item) + 1))))
        yield f"{name}: a text", b'{"%s":"%s"}' % (name.encode(), b"a" * room)
        yield f"{name}: escapes", b'{"%s":"%s"}' % (name.encode(), rb"\u202e" * (room // 6))
        yield f"{name}: depth", b'{"%s":%s}' % (name.encode(), b"[" * (room // 2) + b"]" * (room // 2))


def measure_worst(
    model: type[Request] | type[TraceRequest] | type[BatchRequest], key: str, most: int
) -> tuple[float, str]:
    """The longest time of the process, s, and the body that took it. most: of the bytes that the loop reads."""
    budget = find_request_budget(key)
    assert budget is not None
    times: list[tuple[float, str]] = []
    size = min(budget.max_bytes, most)
    names = list(model.model_fields)[: 2 if size > 1_000_000 else None]
    for what, body in list_bodies(size, names):
        begun_s = time.process_time()
        with pytest.raises(RequestRefused):
            read_request(model, BusSample(key, body), "v: ")
        times.append((time.process_time() - begun_s, what))
    return max(times)


@pytest.mark.parametrize("verb", sorted(SERVICE_VERBS))
def test_no_request_of_a_user_keeps_the_coordinator_busy(verb: str) -> None:
    """A larger one is read by another process."""
    took_s, what = measure_worst(SERVICE_VERBS[verb].request, f"tutti/v1/demo/svc/{verb}", MAX_AT_ONCE)
    assert took_s < COORDINATOR_S, what


COMMANDS = dict(re.findall(r'"([a-z-]+)": \((\w+),', inspect.getsource(ControllerCommands.__init__)))


@pytest.mark.parametrize("verb", sorted(COMMANDS))
def test_no_command_keeps_a_host_busy(verb: str) -> None:
    model: type[Request] = getattr(commands_module, COMMANDS[verb])
    took_s, what = measure_worst(model, f"tutti/v1/demo/ctl/x/cmd/{verb}", 10**9)
    assert took_s < HOST_S, what


@pytest.mark.parametrize("verb", ["arm", "go"])
def test_no_batch_keeps_a_host_busy(verb: str) -> None:
    took_s, what = measure_worst(BatchRequest, f"tutti/v1/demo/host/h/cmd/{verb}", 10**9)
    assert took_s < HOST_S, what


def test_no_question_keeps_a_host_busy() -> None:
    took_s, what = measure_worst(TraceRequest, "tutti/v1/demo/ctl/x/trace", 10**9)
    assert took_s < HOST_S, what


def test_the_table_of_commands_is_not_empty() -> None:
    assert len(COMMANDS) > 20 and "arm" in COMMANDS
