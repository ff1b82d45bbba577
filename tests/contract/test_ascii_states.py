"""What the adapter of described controllers concludes, because no controller reports it: when, and what ends it."""

from contextlib import suppress

import pytest

from adapters.contract import ControllerRestarted, JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.conformance.examples import make_case
from orchestrator.conformance.worlds import World, run_case
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal


async def send_as_other_client(world: World, line: bytes) -> None:
    """Bytes that come from another client of the same controller."""
    world.hit.controller.connect("serial", lambda _: None, lambda: None).receive_bytes(line)
    await sleep_ns(world.clock, 200 * NS_PER_MS)


async def list_lost(world: World) -> list[str]:
    return [name for name, axis in (await world.driver.poll()).axes.items() if axis.position_lost]


async def cycle_power(world: World) -> None:
    """Switch the controller off and on; then the adapter connects again."""
    world.hit.controller.set_power(on=False)
    with suppress(ControllerFault, LinkClosed):
        await world.driver.poll()
    world.hit.controller.set_power(on=True)
    await sleep_ns(world.clock, 5 * NS_PER_S)
    await world.driver.connect()
    await world.driver.configure()


def test_an_alarm_in_motion_loses_the_positions_until_they_are_homed() -> None:
    async def main(world: World) -> None:
        await world.ready()
        assert not await world.manual.home_axes(world.axes, lambda _: None)
        await world.manual.jog_axis(world.axes[0], JogMove(-1000.0, 1000.0, None))
        await sleep_ns(world.clock, NS_PER_S)
        world.hit.controller.set_limit("Y", "forward")  # all motors are stopped dead
        reading = await world.driver.poll()
        assert [fault.code for fault in reading.faults] == ["alarm"]
        assert await list_lost(world) == world.axes
        await world.driver.clear_faults()
        with pytest.raises(ControllerRestarted):  # the alarm has cleared the session number, too
            await world.driver.poll()
        await world.driver.connect()
        await world.driver.configure()
        assert not (await world.driver.poll()).faults and await list_lost(world) == world.axes
        assert not await world.manual.home_axes(world.axes, lambda _: None)
        assert await list_lost(world) == []

    run_case(make_case("ascii"), main)


def test_the_lock_after_power_up_is_no_alarm_and_ends_when_the_axes_are_enabled() -> None:
    async def main(world: World) -> None:
        await world.driver.connect()
        await world.driver.configure()
        reading = await world.driver.poll()
        assert not any(axis.enabled for axis in reading.axes.values())
        assert not reading.faults and not any(axis.position_lost for axis in reading.axes.values())
        await world.driver.set_enabled(world.axes, on=True)
        assert all(axis.enabled for axis in (await world.driver.poll()).axes.values())

    run_case(make_case("ascii"), main)


def test_a_disabled_axis_stays_so_over_a_connection_until_it_is_enabled() -> None:
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.set_enabled(world.axes[:1], on=False)
        await world.driver.connect()
        await world.driver.configure()
        assert not (await world.driver.poll()).axes[world.axes[0]].enabled
        with pytest.raises(Refusal, match="not enabled"):
            await world.arm(await world.plan(world.targets()))
        await world.driver.set_enabled(world.axes[:1], on=True)
        await world.arm(await world.plan(world.targets()))
        await world.driver.slots.unload()

    run_case(make_case("ascii"), main)


@pytest.mark.parametrize("is_stopped", [False, True])
def test_a_controller_that_does_not_answer_while_it_searches_counts_as_moving_until_the_end(is_stopped: bool) -> None:
    async def main(world: World) -> None:
        await world.ready()
        search = world.start_task(_search(world))
        await sleep_ns(world.clock, 300 * NS_PER_MS)
        assert all(axis.moving for axis in (await world.driver.poll()).axes.values())
        if is_stopped:
            await world.driver.stop(abort=False)
        await search
        assert world.at_rest
        await sleep_ns(world.clock, NS_PER_S)
        assert not any(axis.moving for axis in (await world.driver.poll()).axes.values())

    async def _search(world: World) -> None:
        assert bool(await world.manual.home_axes(world.axes, lambda _: None)) is is_stopped

    run_case(make_case("ascii"), main)


def test_a_restart_is_noticed_though_another_client_has_unlocked_the_controller() -> None:
    """In its lock it takes no session number; it was given none later, and its restart was no restart."""

    async def main(world: World) -> None:
        await world.driver.connect()
        await world.driver.configure()
        await send_as_other_client(world, b"$X\n")
        assert not await world.manual.home_axes(world.axes, lambda _: None)
        await cycle_power(world)
        assert (await world.driver.poll()).restarted
        assert not (await world.driver.poll()).restarted

    run_case(make_case("ascii"), main)


def test_a_restart_that_keeps_the_connection_is_noticed_by_the_session_number() -> None:
    async def main(world: World) -> None:
        await world.ready()
        await send_as_other_client(world, b"S0\n")  # what a restart leaves of it
        with pytest.raises(ControllerRestarted):
            await world.driver.poll()
        await world.driver.connect()
        await world.driver.configure()
        assert (await world.driver.poll()).restarted
        assert not (await world.driver.poll()).restarted

    run_case(make_case("ascii"), main)


def test_a_restart_is_noticed_though_the_armed_move_was_withdrawn_in_the_lock_after_it() -> None:
    """The reset of the withdrawal clears the session number, and in the lock the controller takes none."""

    async def main(world: World) -> None:
        await world.ready()
        assert not await world.manual.home_axes(world.axes, lambda _: None)
        await world.arm(await world.plan(world.targets()))
        world.hit.controller.set_power(on=False)
        await sleep_ns(world.clock, NS_PER_S)
        world.hit.controller.set_power(on=True)
        await sleep_ns(world.clock, NS_PER_S)
        await world.driver.slots.unload()
        with pytest.raises(ControllerRestarted):
            await world.driver.poll()
        await world.driver.connect()
        await world.driver.configure()
        assert (await world.driver.poll()).restarted
        assert not (await world.driver.poll()).restarted

    run_case(make_case("ascii"), main)
