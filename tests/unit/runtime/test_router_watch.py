"""The watch on the router in virtual time, with a router that does as it is set."""

from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

from unit.controller_states import make_controller_state

from orchestrator.bus.base import BusSample
from orchestrator.bus.states.feed import Arrival
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.operation.alarms import AlarmRequest
from orchestrator.model.state import Mode
from orchestrator.runtime.examples import find_example
from orchestrator.runtime.live.router_watch import FleetRest, RouterWatch, find_longest_stop_ns

DEMO = load_fleet(find_example("demo.fleet.yaml"))


@dataclass
class World:
    """A router, and a fleet beside it. deaf: it serves no new session."""

    clock: VirtualClock
    deaf: bool = False
    moving: bool = False
    restarts_ns: list[int] = field(default_factory=list[int])
    alarms: list[bool] = field(default_factory=list[bool])
    said: list[str] = field(default_factory=list[str])

    async def probe(self) -> str:
        return "no answer" if self.deaf else ""

    async def restart(self) -> None:
        self.restarts_ns.append(self.clock.now_ns())
        self.deaf = False

    def raise_alarm(self, request: AlarmRequest) -> None:
        self.alarms.append(request.active)


def watch(main: Callable[[World], Coroutine[Any, Any, None]], *, own: bool = True) -> World:
    async def run(clock: VirtualClock) -> World:
        world = World(clock)
        restart = world.restart if own else None
        router = RouterWatch(
            "tcp/r",
            clock,
            world.probe,
            lambda: ["gantry"] if world.moving else [],
            world.raise_alarm,
            restart,
            world.said.append,
        )
        clock.loop.create_task(router.run())
        await main(world)
        return world

    return run_virtual(run)


async def seconds(world: World, count: float) -> None:
    await sleep_ns(world.clock, round(count * NS_PER_S))


def test_a_deaf_router_is_restarted_at_once_if_nothing_moves() -> None:
    async def main(world: World) -> None:
        await seconds(world, 25)
        assert not world.restarts_ns
        world.deaf = True
        await seconds(world, 60)

    world = watch(main)
    assert len(world.restarts_ns) == 1 and world.restarts_ns[0] <= 38 * NS_PER_S
    assert world.alarms == [True, False]


def test_while_the_fleet_moves_it_waits_and_keeps_the_alarm() -> None:
    async def main(world: World) -> None:
        world.deaf = world.moving = True
        await seconds(world, 200)
        assert not world.restarts_ns and world.alarms == [True] * 4
        world.moving = False
        await seconds(world, 30)

    world = watch(main)
    assert len(world.restarts_ns) == 1 and world.alarms[-1] is False
    waiting = "the router is restarted when the fleet rests; not at rest: gantry"
    assert world.said.count(waiting) == 1


def test_one_failure_is_none() -> None:
    async def main(world: World) -> None:
        await seconds(world, 19.5)
        world.deaf = True
        await seconds(world, 1)
        world.deaf = False
        await seconds(world, 60)

    world = watch(main)
    assert not world.restarts_ns and not world.alarms


def test_a_router_of_others_is_an_alarm_only() -> None:
    async def main(world: World) -> None:
        world.deaf = True
        await seconds(world, 90)
        world.deaf = False
        await seconds(world, 20)

    world = watch(main, own=False)
    assert not world.restarts_ns
    assert world.alarms[0] is True and world.alarms[-1] is False and len(world.said) == 1


def make_sample(controller: str, mode: Mode) -> Arrival:
    return arrive(make_controller_state(controller, mode=mode).to_json())


def arrive(payload: bytes) -> Arrival:
    return Arrival("host", [BusSample("tutti/v1/lab/ctl/x/state", payload)], {})


def test_a_fleet_rests_when_each_controller_does() -> None:
    async def main(clock: VirtualClock) -> None:
        rest = FleetRest(clock, NS_PER_S)
        rest.take_arrival(make_sample("a", "moving"))
        rest.take_arrival(make_sample("b", "idle"))
        assert rest.list_moving() == ["a"]
        rest.take_arrival(arrive(b"not a state"))
        rest.take_arrival(make_sample("a", "offline"))
        assert not rest.list_moving()

    run_virtual(main)


def test_a_state_in_motion_counts_no_longer_than_a_motion_without_the_router_lasts() -> None:
    """A router that hangs in a motion, and one forged state of a controller that does not exist."""

    async def main(clock: VirtualClock) -> None:
        longest_ns = find_longest_stop_ns(DEMO)
        assert 1.2 * NS_PER_S < longest_ns < 5 * NS_PER_S
        rest = FleetRest(clock, longest_ns)
        world = World(clock)
        restart = world.restart
        router = RouterWatch(
            "tcp/r", clock, world.probe, rest.list_moving, world.raise_alarm, restart, world.said.append
        )
        clock.loop.create_task(router.run())
        for name in ("gantry", "forged"):
            rest.take_arrival(make_sample(name, "moving"))
        world.deaf = True
        await seconds(world, 30)
        assert len(world.restarts_ns) == 1

        # States that arrive keep it from being restarted.
        world.deaf = True
        for _ in range(60):
            rest.take_arrival(make_sample("gantry", "moving"))
            await seconds(world, 1)
        assert len(world.restarts_ns) == 1
        assert world.said[-1].endswith("not at rest: gantry")

    run_virtual(main)
