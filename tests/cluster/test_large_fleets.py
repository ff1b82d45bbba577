"""200 controllers on four hosts, and what goes wrong for many of them at once: it is named once, and counted."""

import asyncio
import json
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from cluster.test_alarms import QUICK, Commands, states

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.gateway.stream.hub import StreamHub
from orchestrator.gateway.stream.merge_patch import apply_patch
from orchestrator.gateway.stream.need import WITHOUT_CONTROLLERS
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.runtime.simulated_fleets import make_light_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

HOSTS = 4
LOST = "h1"
SILENT_NS = 700 * NS_PER_MS
STOPPED_NS = SILENT_NS + 300 * NS_PER_MS
"""From the loss of a host to the ramps of all others: a look at the members, and the stops of 150."""


def run_large(
    main: Callable[[VirtualFleet], Coroutine[Any, Any, None]], count: int = 200, *, quick: bool = False
) -> None:
    """Run `main` with a fleet of one axis a controller. quick: alarms are raised soon."""
    plain: dict[str, Any] = make_light_fleet(count, HOSTS).to_plain() | {"groups": {}, "notify": {"command": ["page"]}}
    if quick:
        plain["alarms"] = QUICK
    for config in plain["controllers"].values():
        config["axes"] = {"x": config["axes"]["x"]}

    async def run(clock: VirtualClock) -> None:
        fleet = VirtualFleet(Fleet.model_validate(plain), clock, 1, guardian=False)
        await fleet.start()
        await main(fleet)

    run_virtual(run)


def make_job(*steps: dict[str, Any]) -> Job:
    return Job.model_validate({"schema": "tutti.job/1", "name": "all", "max_start_skew": "5 ms", "steps": steps})


def test_a_host_that_vanishes_in_a_step_of_all_stops_the_others_and_is_named_once() -> None:
    async def main(fleet: VirtualFleet) -> None:
        pages, client, names = Commands(fleet), fleet.make_client(), list(fleet.fleet.controllers)
        prepare = make_job({"do": "enable", "axes": names}, {"do": "home", "axes": names})
        assert (await client.wait_for_job(await client.submit(prepare))).state == "done"
        job_id = await client.submit(make_job({"do": "move", "to": {f"{name}.x": 300 for name in names}, "speed": 0.1}))
        await fleet.wait_until(lambda states: all(state.axes["x"].moving for state in states.values()))
        fleet.kill(f"host/{LOST}")
        lost_ns = fleet.clock.now_ns()
        report = await client.wait_for_job(job_id)
        assert report.state == "failed"
        lost_names = [name for name, config in fleet.fleet.controllers.items() if config.host == LOST]
        assert len(lost_names) == 50
        assert report.reason == f"step 1 (move): c50: its adapter is silent (as with 49 more of host {LOST})"
        await sleep_ns(fleet.clock, NS_PER_S)
        for name in names:
            (motion,) = fleet.controllers[name].commanded_motions
            if name in lost_names:
                assert motion.end_ns is None  # nothing reaches it
            else:
                assert motion.slowing_ns is not None and motion.slowing_ns - lost_ns < STOPPED_NS, name
        await asyncio.sleep(6.0)
        alarms = await states(fleet)
        assert f"many-disconnected-{LOST}" in alarms
        assert [alarm for alarm in alarms if any(alarm.endswith(f"-{name}") for name in names)] == []
        assert pages.alarms.count(f"many-disconnected-{LOST}") == 1
        assert len(pages.alarms) == len(alarms) <= 2, (pages.alarms, alarms)

    run_large(main, quick=True)


@pytest.mark.parametrize("count", [200, pytest.param(1000, marks=pytest.mark.nightly)])
def test_faults_of_all_in_one_second_are_one_alarm_with_their_number_and_one_update_of_a_page(count: int) -> None:
    """Several of each; with a page that shows no controllers."""

    async def main(fleet: VirtualFleet) -> None:
        pages, hub = Commands(fleet), StreamHub(fleet.make_client("gateway"), fleet.clock)
        await hub.start()
        await asyncio.sleep(1.0)
        updates: list[dict[str, Any]] = []
        reader, shown = hub.add_reader(WITHOUT_CONTROLLERS), dict[str, Any]()

        def take() -> None:
            nonlocal shown
            frame = json.loads(reader.take_frame() or "{}")
            before = shown.get("alarms", {})
            shown = frame["state"] if "state" in frame else apply_patch(shown, frame.get("patch", {}))
            if shown.get("alarms", {}) != before:
                updates.append(shown["alarms"])

        reader.wake = take
        take()
        faults = 0

        def break_reply(_: bytes) -> bytes:
            nonlocal faults
            faults += 1
            return b"no state"

        for wire in fleet.wires.values():
            wire.to_near = break_reply
        await asyncio.sleep(1.0)
        for wire in fleet.wires.values():
            wire.to_near = None
        assert faults >= 3 * count
        await asyncio.sleep(3.0)
        assert len(updates) == 1
        await asyncio.sleep(5.0)
        (alarm,) = await fleet.make_client().list_alarms()
        first_names = ", ".join(sorted(fleet.fleet.controllers)[:3])
        assert alarm.id == "many-fault-garbage-fleet" and alarm.count == 1
        assert alarm.text.startswith(f"fault garbage: all {count} controllers ({first_names} and {count - 3} more); ")
        assert pages.alarms == [alarm.id]
        # And one more as it is over.
        assert [[record["state"] for record in update.values()] for update in updates] == [
            ["unacknowledged"],
            ["returned"],
        ]
        await hub.close()

    run_large(main, count)
