"""Controllers whose link goes and comes, and adapters with a defect: stops are tried again and again, before anything
else, and the adapter always connects again."""

import asyncio
from typing import Any

import pytest
from cluster.test_faults import pair, prepared
from cluster.worlds import PREPARE, job, outcome, run_fleet

from adapters.shrc203.driver import ShrcDriver
from orchestrator.clock.base import NS_PER_MS, sleep_until_ns
from orchestrator.runtime.virtual.fleet import VirtualFleet

STAGE = job("[{do: move, to: {stage.u: 40}, speed: 0.15}]")  # half a minute
OPENING_NS = 20 * NS_PER_MS  # of the link, and the bytes of the stop


async def moving_stage(fleet: VirtualFleet) -> None:
    assert (await outcome(fleet, PREPARE)).state == "done"
    await fleet.make_client().submit(STAGE)
    await fleet.wait_until(lambda states: states["stage"].mode == "moving")
    await asyncio.sleep(1.0)


def slowing_ns(fleet: VirtualFleet) -> int | None:
    return fleet.controllers["stage"].commanded_motions[-1].slowing_ns


@pytest.mark.parametrize("dead", [False, True], ids=["refused", "silent"])
@pytest.mark.parametrize("away_ms", [900, 4000, 7150])
def test_a_stop_reaches_an_axis_within_200_ms_of_its_link(away_ms: int, *, dead: bool) -> None:
    """The port is gone, or it opens and its bytes are lost; for longer than any pause between attempts."""

    async def main(fleet: VirtualFleet) -> None:
        await moving_stage(fleet)
        wire = fleet.wires["stage"]
        back_ns = fleet.clock.now_ns() + away_ms * NS_PER_MS
        wire.refuse, wire.cut = not dead, dead
        for link in list(wire.links):
            link.hang_up()
        await fleet.make_client().estop("test")
        await sleep_until_ns(fleet.clock, back_ns)
        assert slowing_ns(fleet) is None
        wire.refuse = wire.cut = False
        await asyncio.sleep(1.0)
        stopped_ns = slowing_ns(fleet)
        assert stopped_ns is not None and stopped_ns - back_ns < 200 * NS_PER_MS + OPENING_NS

    run_fleet(main)


def test_an_estop_ends_the_pause_before_the_next_attempt() -> None:
    """The controller was at rest when its link was lost, so no stop was pending, and attempts were rare. It moves when
    the e-stop comes, by another client."""

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        wire = fleet.wires["stage"]
        wire.refuse = True
        for link in list(wire.links):
            link.hang_up()
        await asyncio.sleep(20.0)
        wire.refuse = False
        attempts: list[int] = []
        wire.to_far = lambda data: attempts.append(fleet.clock.now_ns()) or data
        pressed_ns = fleet.clock.now_ns()
        await fleet.make_client().estop("test")
        await asyncio.sleep(0.1)
        assert attempts and attempts[0] - pressed_ns < OPENING_NS

    run_fleet(main)


def test_an_estop_precedes_an_attempt_to_connect_that_is_under_way() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        wire = fleet.wires["stage"]
        written: list[tuple[int, bytes]] = []
        wire.to_far = lambda data: written.append((fleet.clock.now_ns(), data)) or data
        wire.cut = True
        for link in list(wire.links):
            link.hang_up()
        written.clear()
        while not written:  # it waits for the reply to its first line
            await asyncio.sleep(0.001)
        pressed_ns = fleet.clock.now_ns()
        wire.cut = False
        await fleet.make_client().estop("test")
        await asyncio.sleep(0.1)
        assert any(at_ns - pressed_ns < OPENING_NS and b"L:" in data for at_ns, data in written if at_ns >= pressed_ns)

    run_fleet(main)


@pytest.mark.parametrize("make", ["smc30", "cia402"])
def test_stops_and_silence_on_a_shared_line_end_no_task(make: str) -> None:
    """A stop of one controller disturbs the exchanges by which the other one is being connected."""

    async def main(fleet: VirtualFleet) -> None:
        await asyncio.sleep(3.0)
        names = list(fleet.controllers)
        wire = fleet.wires[names[0]]
        wire.cut = True
        for link in list(wire.links):
            link.hang_up()
        await fleet.make_client().estop("test")
        await asyncio.sleep(8.0)
        wire.cut = False
        await fleet.wait_until(lambda states: all(states[name].mode != "offline" for name in names))
        await fleet.make_client().reset()
        await prepared(fleet)

    run_fleet(main, pair(make))


@pytest.mark.parametrize("place", ["connect", "poll", "background", "command"])
def test_a_defect_is_a_fault_of_its_controller_and_is_tried_again(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    broken: list[str] = []
    names = {"connect": "connect", "poll": "poll", "background": "check_settings", "command": "set_enabled"}
    made: Any = getattr(ShrcDriver, names[place])

    async def fail(driver: ShrcDriver, *values: Any, **fields: Any) -> Any:
        if broken:
            raise ValueError("cannot convert float infinity to integer")
        return await made(driver, *values, **fields)

    monkeypatch.setattr(ShrcDriver, names[place], fail)

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        defects: list[dict[str, Any]] = []
        # In virtual time it would end the run.
        monkeypatch.setattr(asyncio.get_running_loop(), "call_exception_handler", defects.append)
        broken.append(place)
        if place == "connect":
            for link in list(fleet.wires["stage"].links):
                link.hang_up()
        if place == "command":
            report = await outcome(fleet, job("[{do: enable, axes: [stage]}]"))
            assert report.state == "failed" and "a defect of the adapter, ValueError: cannot conv" in report.reason
        text = "a defect of the adapter, ValueError: cannot convert float infinity"
        times = "" if place == "command" else "(defect number 3 since"
        await fleet.wait_until(
            lambda states: any(
                each.code == "adapter-defect" and text in each.text and times in each.text
                for each in states["stage"].faults
            )
        )
        await asyncio.sleep(8.0)
        assert len(defects) < 12
        broken.clear()
        await fleet.wait_until(lambda states: states["stage"].mode == "idle")
        await fleet.make_client().start_queue()
        assert (await outcome(fleet, PREPARE)).state == "done"

    run_fleet(main)
