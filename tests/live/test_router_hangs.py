"""The router hangs, as after a SIGSTOP, once at each stage of a step; then the fleet works again without a person.

The stages are those of the fault campaign, which does the same in virtual time. They are recognised by the files that
the processes write on this computer: nothing passes on the bus meanwhile.
"""

import asyncio
import json
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from children import wait_until
from fleet import SLOW, SLOW_AXES, Entry, RunningFleet, Steps, margin_s

from orchestrator.client import Tutti
from orchestrator.clock.live import raw_ns

pytestmark = [pytest.mark.live, pytest.mark.nightly]

STOPPED_S = 0.5 + 0.3 + 1.5  # without a coordinator, by a ramp, on a busy machine
ROUTER = "orchestrator.bus.zenoh.router"
BROKEN_OFF = ("failed", "aborted", "interrupted")
WAITING = ("queued", "held")  # a job that had not begun: nothing begins by itself after a break
JOG_S = 20.0

SHORT: Steps = [{"do": "move", "to": {"gantry.x": position}, "speed": 0.1} for position in (30, 5)]
AT_ONCE: Steps = [{**step, "start": "at_once"} for step in SHORT]
SCAN: Steps = [
    {
        "do": "scan",
        "axes": {"gantry.x": {"values": [30, 5, 30, 5]}},
        "speed": 0.1,
        "at_each": [{"do": "dwell", "duration": "50 ms"}],
    }
]
PATH: Steps = [
    {
        "do": "path",
        "axes": ["gantry.x", "gantry.y"],
        "start": [1, 1],
        "speed": "10 mm/s",
        "corner": {"within": "0.5 mm"},
        "tolerance": "1 mm",
        "pieces": [{"piece": "line", "to": [200, 1]}, {"piece": "line", "to": [200, 30]}],
    }
]
TRIGGERS: Steps = [{**SLOW[0], "triggers": [{"output": "gantry.lamp", "every": "5 mm", "of": "gantry.x"}]}]
HOMING: Steps = [{"do": "home", "axes": ["gantry.y"]}]


class LogFile:
    """What a process writes from now on."""

    def __init__(self, fleet: RunningFleet, name: str) -> None:
        self._path: Path = fleet.state / "log" / f"{name}.jsonl"
        self._offset = self._path.stat().st_size
        self._entries: list[Entry] = []

    def read_entries(self) -> list[Entry]:
        with self._path.open("rb") as file:
            file.seek(self._offset)
            whole_lines = file.read().rpartition(b"\n")[0]
        if whole_lines:
            self._offset += len(whole_lines) + 1
            self._entries += [json.loads(line) for line in whole_lines.splitlines()]
        return self._entries


def hang_router(fleet: RunningFleet, until: Callable[[], bool], what: str) -> tuple[int, int]:
    """Stop the router when `until` holds; its process, and the host time of that."""
    router = fleet.pid(ROUTER)
    wait_until(until, what)
    os.kill(router, signal.SIGSTOP)
    return router, raw_ns()


def has_state(log: LogFile, state: str) -> bool:
    return any(entry["text"] == f"job is {state}" for entry in log.read_entries())


def count_kind(log: LogFile, kind: str) -> int:
    return sum(entry.get("kind") == kind for entry in log.read_entries())


def require_works_again(fleet: RunningFleet, router: int, stopped_ns: int) -> None:
    """The router is replaced, after a pause that grows with each restart; everything has stopped in time, the fleet is
    adopted and idle, and nothing has begun."""
    wait_until(lambda: _find_routers(fleet) - {router} != set(), "the router that hangs is replaced")
    starts = {name: fleet.starts(name) for name in SLOW_AXES}
    for name in SLOW_AXES:
        last = fleet.truth(name)[-1]
        assert last["event"] == "end" and margin_s(stopped_ns, last["end_ns"]) < STOPPED_S, (name, last)
    fleet.works()
    sys.stdout.write(f"works again after {margin_s(stopped_ns, raw_ns()):.1f} s\n")
    assert {name: fleet.starts(name) for name in SLOW_AXES} == starts


def _find_routers(fleet: RunningFleet) -> set[int]:
    return {pid for pid, command in fleet.family().items() if ROUTER in command}


# By stage: the steps of the job, the process whose log shows the stage, and what it shows then.
STAGES: dict[str, tuple[Steps, str, Callable[[LogFile], bool]]] = {
    "home": (HOMING, "coordinator", lambda log: has_state(log, "running")),
    "propose": (SLOW, "coordinator", lambda log: has_state(log, "planning")),
    "arm": (SLOW, "coordinator", lambda log: has_state(log, "arming")),
    "commit": (SLOW, "coordinator", lambda log: has_state(log, "armed")),
    "go": (SLOW, "coordinator", lambda log: has_state(log, "committed")),
    "fire": (SLOW, "coordinator", lambda log: has_state(log, "running")),
    "motion": (SLOW, "host-local", lambda log: count_kind(log, "started") == len(SLOW_AXES)),
    "chain": (SHORT, "host-local", lambda log: count_kind(log, "started") > 0),
    "between steps": (SHORT, "host-local", lambda log: count_kind(log, "done") > 0),
    "path": (PATH, "host-local", lambda log: count_kind(log, "started") > 0),
    "scan": (SCAN, "host-local", lambda log: count_kind(log, "started") > 1),
    "trigger": (TRIGGERS, "host-local", lambda log: count_kind(log, "started") == len(SLOW_AXES)),
    "at-once": (AT_ONCE, "host-local", lambda log: count_kind(log, "started") > 0),
}


@pytest.mark.parametrize("stage", STAGES)
def test_a_fleet_works_again_after_its_router_hung_in_a_step(shared: RunningFleet, stage: str) -> None:
    steps, process, shows_stage = STAGES[stage]
    shared.ready() if stage == "path" else shared.bring_back()
    log = LogFile(shared, process)
    job_id = shared.submit(steps)
    router, stopped_ns = hang_router(shared, lambda: shows_stage(log), stage)
    require_works_again(shared, router, stopped_ns)
    shown = shared.ask(lambda tutti: tutti.show_job(job_id))
    assert shown.entry is not None
    if shown.entry.state in WAITING:
        shared.ask(lambda tutti: tutti.cancel_job(job_id))
    else:
        report = shared.wait(job_id)  # which may wait for the logs of its members
        assert report.state == "done" or (report.state in BROKEN_OFF and report.reason), report.state
    shared.bring_back()


def test_a_fleet_works_again_after_its_router_hung_at_rest(shared: RunningFleet) -> None:
    shared.bring_back()
    router, stopped_ns = hang_router(shared, lambda: True, "now")
    require_works_again(shared, router, stopped_ns)
    shared.bring_back()


def test_a_fleet_works_again_after_its_router_hung_in_a_jog(shared: RunningFleet) -> None:
    shared.bring_back()
    before = shared.starts("gantry")

    async def jog(tutti: Tutti) -> tuple[int, int]:
        async with tutti.manual_control(["gantry.x"], "test", ttl_s=3.0) as manual:
            await manual.jog({"gantry.x": 5.0}, valid_ms=200)
            end_s = time.monotonic() + JOG_S
            while shared.starts("gantry") == before:
                assert time.monotonic() < end_s
                await manual.renew_jog(valid_ms=200)
                await asyncio.sleep(0.05)
            return hang_router(shared, lambda: True, "now")

    router, stopped_ns = shared.ask(jog)
    require_works_again(shared, router, stopped_ns)
    shared.bring_back()
