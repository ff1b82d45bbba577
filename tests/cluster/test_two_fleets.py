"""Two fleets with coordinators of their own on one bus."""

from typing import Any

from orchestrator.bench.scale import DISTANCE
from orchestrator.client.api import Tutti
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.runtime.simulated_fleets import make_light_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet


def test_fleets_on_one_bus_move_and_stop_by_themselves() -> None:
    run_virtual(_move_and_stop)


async def _move_and_stop(clock: VirtualClock) -> None:
    first = VirtualFleet(make_light_fleet(2, 1), clock, 1, guardian=False)
    await first.start()
    second = VirtualFleet(make_other_fleet(3), clock, 2, guardian=False)
    second.net = first.net
    second.start_host("other")
    second.start_coordinator("other")
    await second.wait_until(lambda states: all(state.epoch and state.mode == "idle" for state in states.values()))
    here, there = first.make_client("here"), second.make_client("there")
    # Controllers of one name are two, each of its fleet.
    assert (list(await here.status()), list(await there.status())) == (["c0", "c1"], ["c0", "c1", "c2"])
    for tutti, virtual in ((here, first), (there, second)):
        names = list(virtual.fleet.controllers)
        assert await run_job(tutti, [{"do": "enable", "axes": names}, {"do": "home", "axes": names}]) == "done"
    counts = [len(controller.commanded_motions) for controller in first.controllers.values()]
    assert await run_job(there, [move(second)]) == "done"
    assert [len(controller.commanded_motions) for controller in first.controllers.values()] == counts
    assert await here.estop("only here") == {"c0": True, "c1": True}
    assert all(state.estop is None for state in (await there.status()).values())
    assert await run_job(there, [move(second)]) == "done"


def make_other_fleet(count: int) -> Fleet:
    """A fleet whose controllers have the names of those of the first one."""
    plain = make_light_fleet(count, 1).to_plain()
    controllers = {name: {**config, "host": "other"} for name, config in plain["controllers"].items()}
    return Fleet.model_validate({**plain, "fleet": "other", "controllers": controllers})


def move(virtual: VirtualFleet) -> dict[str, Any]:
    return {"do": "move", "by": dict.fromkeys(virtual.fleet.axis_names, DISTANCE)}


async def run_job(tutti: Tutti, steps: list[dict[str, Any]]) -> str:
    """Run a job and return the state at its end."""
    plain = {"schema": "tutti.job/1", "name": "work", "max_start_skew": "5 ms", "steps": steps}
    return (await (await tutti.submit(Job.model_validate(plain))).result()).state
