"""When the controllers of a job count as resting, by states that the test scripts."""

from types import SimpleNamespace
from typing import Any, cast

import pytest
from cluster.worlds import demo_fleet, job

from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.jobs.run.rest import REST_NS, REST_POLL_NS, RestMonitor

STOP_NS = 300 * NS_PER_MS


@pytest.mark.parametrize(
    ("mode", "axis", "rests"),
    [
        ("idle", {}, True),
        ("stopping", {}, False),
        ("moving", {}, False),
        ("idle", {"moving": True}, False),
        ("idle", {"homing": True}, False),
    ],
)
def test_a_controller_rests_once_neither_its_mode_nor_an_axis_says_otherwise(
    mode: str, axis: dict[str, bool], rests: bool
) -> None:
    async def main(clock: VirtualClock) -> None:
        states = [SimpleNamespace(mode=mode, axes={"x": SimpleNamespace(**{"moving": False, "homing": False} | axis)})]
        states += [SimpleNamespace(mode="idle", axes={"x": SimpleNamespace(moving=False, homing=False)})]

        async def query_state(member: str, since_ns: int | None) -> Any:
            return states.pop(0)

        async def query_info(member: str) -> Any:
            return SimpleNamespace(costs=SimpleNamespace(stop_ns=STOP_NS))

        view = SimpleNamespace(fleet=demo_fleet(), query_state=query_state, infos=SimpleNamespace(query=query_info))
        services = SimpleNamespace(view=view, clock=clock, motion=SimpleNamespace(stop_times_ns={}))
        steps = SimpleNamespace(list_steps=lambda first: job("[{do: move, to: {gantry.x: 1}}]").steps)
        began_ns = clock.now_ns()
        await RestMonitor(cast(Any, services), cast(Any, steps), 0).wait_for_rest()
        assert clock.now_ns() - began_ns == (0 if rests else REST_POLL_NS) < STOP_NS + REST_NS
        assert bool(states) == rests

    run_virtual(main)
