"""The end of a foreground command: what is stopped, what is said, and the exit code."""

import asyncio
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from orchestrator.cli.jobs import foreground
from orchestrator.cli.jobs.foreground import Interrupts, controllers_of, stop_own_job
from orchestrator.client import Tutti
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job


class FakeTutti:
    """A fleet of one gantry. cancels, stops: how the coordinator and the adapter answer."""

    actor = "anna"

    def __init__(self, cancels: Callable[[], Awaitable[None]], stops: Callable[[], Awaitable[None]]) -> None:
        self._cancels = cancels
        self._stops = stops
        self.stopped: list[str] = []

    async def cancel_job(self, job_id: str) -> None:
        assert job_id == "j"
        await self._cancels()

    async def wait_for_job(self, _: str) -> Any:
        return SimpleNamespace(state="cancelled")

    async def request_controller(self, controller: str, verb: str, *_: object) -> None:
        assert verb == "stop"
        await self._stops()
        self.stopped.append(controller)

    def request_fields(self) -> dict[str, Any]:
        return {"request_id": "r", "actor": self.actor}

    async def status(self, timeout_s: float = 1.0) -> dict[str, Any]:
        del timeout_s
        axis = SimpleNamespace(position=12.5, unit="mm", moving=True, homing=False)
        return {"gantry": SimpleNamespace(mode="moving", axes={"x": axis})}


async def accept() -> None:
    return None


async def refuse() -> None:
    raise Refusal("no-coordinator", "fleet demo has no active coordinator", "")


async def hang() -> None:
    await asyncio.Event().wait()


def end(tutti: FakeTutti, interrupts: Interrupts, monkeypatch: pytest.MonkeyPatch) -> tuple[list[str], int | None]:
    """What is said, and the exit code; None: the caller goes on."""
    said: list[str] = []
    monkeypatch.setattr(foreground, "say", said.append)
    try:
        asyncio.run(stop_own_job(cast(Tutti, tutti), "j", ["gantry"], interrupts))
    except SystemExit as ended:
        return said, cast(int, ended.code)
    return said, None


def test_the_first_interrupt_stops_and_reports(monkeypatch: pytest.MonkeyPatch) -> None:
    said, code = end(FakeTutti(accept, refuse), Interrupts(), monkeypatch)
    assert said == ["stopping …", "stopped: gantry.x 12.500 mm"]
    assert code is None


def test_without_a_coordinator_the_controllers_are_stopped_directly(monkeypatch: pytest.MonkeyPatch) -> None:
    tutti = FakeTutti(refuse, accept)
    said, code = end(tutti, Interrupts(), monkeypatch)
    assert tutti.stopped == ["gantry"]
    assert said[1].startswith("stopped: gantry; the coordinator has not confirmed the end of the job")
    assert code is None


@pytest.mark.parametrize("named", [[], ["table"]])
def test_without_names_of_controllers_all_are_stopped(monkeypatch: pytest.MonkeyPatch, named: list[str]) -> None:
    tutti = FakeTutti(refuse, accept)
    monkeypatch.setattr(foreground, "say", lambda _: None)
    asyncio.run(stop_own_job(cast(Tutti, tutti), "j", named, Interrupts()))
    assert tutti.stopped == ["gantry"]


def test_a_stop_that_cannot_be_sent_is_said_in_capitals(monkeypatch: pytest.MonkeyPatch) -> None:
    said, code = end(FakeTutti(refuse, refuse), Interrupts(), monkeypatch)
    assert said[1].startswith("NOT STOPPED (")
    assert "estop" in said[2]
    assert code == 1


def test_a_second_interrupt_leaves_at_once_and_says_what_still_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    interrupts = Interrupts()

    async def interrupt_again() -> None:
        interrupts.note_interrupt()
        await hang()

    said, code = end(FakeTutti(interrupt_again, accept), interrupts, monkeypatch)
    assert said[1] == "left before the stop was complete: gantry.x still moves"
    assert code == 130


def test_the_controllers_of_a_manual_job() -> None:
    steps = [
        {"do": "move", "to": {"gantry.x": 1}},
        {"do": "home", "axes": ["stage"]},
        {"do": "output", "output": "lamp.red", "value": True},
    ]
    job = Job.model_validate({"schema": "tutti.job/1", "name": "n", "steps": steps})
    assert controllers_of(job) == ["gantry", "stage", "lamp"]
