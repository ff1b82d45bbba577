"""Jog commands that take long to reach the controller, or are disturbed on the link."""

import asyncio
from contextlib import suppress

import pytest
from cluster.worlds import outcome, run_fleet

from orchestrator.campaign.fleets import MAKES, make_campaign_fleet
from orchestrator.campaign.jobs import make_preparation
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

AFTER_MS = (3, 25, 120)  # the request
MORE_MS = (1, 8, 70)
DEAF_NS = 400 * NS_PER_MS

# Time until the axis is at rest again, by the fault of the line: a closed one is reopened and used for the stop first.
RESTS_NS = {"closed": 1500 * NS_PER_MS, "deaf": DEAF_NS + 2500 * NS_PER_MS}


def one_of(make: str) -> tuple[Fleet, str, str, float]:
    """A fleet with a controller of that make, its name, its axis, and a speed to jog it at."""
    fleet = make_campaign_fleet(3, [make])
    name, config = next(each for each in fleet.controllers.items() if each[1].adapter == make)
    axis = f"{name}.{next(iter(config.axes))}"
    return fleet, name, axis, fleet.axis(axis).limits.velocity * 0.05


async def prepared(virtual: VirtualFleet) -> None:
    every = list(virtual.controllers)
    assert (await outcome(virtual, make_preparation(virtual.fleet, every, every))).state == "done"


@pytest.mark.parametrize("make", MAKES)
def test_the_first_press_moves_an_axis_of_every_make_and_it_changes_its_speed(make: str) -> None:
    """Some commands take longer to send than their validity."""
    fleet, name, axis, speed = one_of(make)

    async def main(virtual: VirtualFleet) -> None:
        await prepared(virtual)
        unit, motor = virtual.controllers[name], fleet.axis(axis).motors[0]
        async with virtual.make_client().manual_control([axis]) as hand:
            await hand.jog({axis: speed})
            for _ in range(15):
                await hand.renew_jog()
                await asyncio.sleep(0.06)
            assert unit.is_moving(motor)
            for _ in range(15):
                await hand.renew_jog({axis: speed / 2})
                await asyncio.sleep(0.06)
            assert unit.is_moving(motor)
            await hand.stop()
        await asyncio.sleep(1.5)
        assert not unit.is_moving(motor)

    run_fleet(main, fleet)


@pytest.mark.parametrize(
    ("how", "moments_ms"),
    [
        ("deaf", AFTER_MS),
        pytest.param("deaf", MORE_MS, marks=pytest.mark.nightly),
        pytest.param("closed", AFTER_MS + MORE_MS, marks=pytest.mark.nightly),
    ],
)
@pytest.mark.parametrize("make", MAKES)
def test_a_jog_command_that_is_disturbed_on_the_link_moves_nothing_for_long(
    make: str, how: str, moments_ms: tuple[int, ...]
) -> None:
    fleet, name, axis, speed = one_of(make)

    async def press(client: Tutti) -> None:
        with suppress(Refusal):
            async with client.manual_control([axis]) as hand:
                await hand.jog({axis: speed})
                await asyncio.sleep(1.0)

    async def disturb(virtual: VirtualFleet) -> None:
        wire = virtual.wires[name]
        if how == "closed":
            for link in list(wire.links):
                link.hang_up()
        else:
            wire.to_far = lambda _: b""
            virtual.clock.call_at_ns(virtual.clock.now_ns() + DEAF_NS, lambda: setattr(wire, "to_far", None))

    async def main(virtual: VirtualFleet) -> None:
        await prepared(virtual)
        client, motions = virtual.make_client(), virtual.controllers[name].commanded_motions
        for after_ms in moments_ms:
            before = len(motions)
            pressing = asyncio.get_running_loop().create_task(press(client))
            await asyncio.sleep(after_ms / 1000)
            at_ns = virtual.clock.now_ns()
            await disturb(virtual)
            await asyncio.sleep(RESTS_NS[how] / NS_PER_S)
            ends = [motion.end_ns for motion in motions[before:]]
            assert all(end_ns is not None and end_ns < at_ns + RESTS_NS[how] for end_ns in ends), (after_ms, ends)
            await pressing
            await client.reset()
            await virtual.wait_until(lambda states: name in states and states[name].mode == "idle")
            assert (await outcome(virtual, make_preparation(virtual.fleet, [name], [name]))).state == "done"

    run_fleet(main, fleet)


@pytest.mark.parametrize("deaf_s", [1.6, *(pytest.param(s, marks=pytest.mark.nightly) for s in (0.6, 1.1, 2.0))])
@pytest.mark.parametrize("make", MAKES)
def test_an_axis_that_was_jogged_when_its_line_broke_is_stopped_as_soon_as_it_answers(make: str, deaf_s: float) -> None:
    """The line comes back after the pending stop was written, while the controller is being connected."""
    fleet, name, axis, speed = one_of(make)

    async def main(virtual: VirtualFleet) -> None:
        await prepared(virtual)
        unit, wire = virtual.controllers[name], virtual.wires[name]
        before = len(unit.commanded_motions)
        with suppress(Refusal):
            async with virtual.make_client().manual_control([axis]) as hand:
                await hand.jog({axis: speed})
                await hand.renew_jog()
                wire.cut = True
                await asyncio.sleep(deaf_s)
                wire.cut = False
        back_ns = virtual.clock.now_ns()
        await asyncio.sleep(2.5)
        ends = [motion.end_ns for motion in unit.commanded_motions[before:]]
        assert ends and all(end_ns is not None and end_ns < back_ns + 2 * NS_PER_S for end_ns in ends), ends

    run_fleet(main, fleet)
