"""Motor records over a virtual fleet: no server, and nothing of EPICS."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from cluster.worlds import EXAMPLES

from integrations.epics.axes import open_axes
from integrations.epics.record import MotorRecord
from tutti import JobFailed, Tutti
from tutti.testing import VirtualTestbed, virtual_fleet

Main = Callable[[Tutti, dict[str, MotorRecord]], Awaitable[None]]


def run(main: Main, *, prepared: bool = True) -> None:
    """Run `main` with the records of the demo fleet, by axis."""

    async def serve(tutti: Tutti) -> None:
        async with open_axes(tutti) as axes:
            await main(tutti, {axis.record.axis: axis.record for axis in axes})

    with virtual_fleet(EXAMPLES / "demo.fleet.yaml") as fleet:
        if prepared:
            prepare(fleet)
        fleet.run(serve)


def prepare(fleet: VirtualTestbed) -> None:
    fleet.tutti.enable()
    fleet.tutti.home()


def begin_put(record: MotorRecord, name: str, value: Any) -> "asyncio.Future[str | None]":
    """Put a field; the future has the error, or None."""
    ended: asyncio.Future[str | None] = asyncio.get_running_loop().create_future()
    record.put(name, value, ended.set_result)
    return ended


def follow_dmov(record: MotorRecord) -> list[int]:
    history = [int(record.values["DMOV"])]
    record.follow("DMOV", lambda value, _: history.append(int(value)))
    return history


async def until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(0.01)


def test_a_put_ends_with_its_move_and_reads_where_it_ended() -> None:
    async def main(tutti: Tutti, records: dict[str, MotorRecord]) -> None:
        x = records["gantry.x"]
        assert x.values["VELO"] == 40 and x.values["HLM"] == 400 and x.values["EGU"] == "mm"
        history = follow_dmov(x)
        for target in (10, 12, 12):
            assert await begin_put(x, "VAL", target) is None
            assert x.values["RBV"] == pytest.approx(target, abs=0.002)
            assert await tutti.position("gantry.x") == pytest.approx(target, abs=0.002)
        await asyncio.sleep(2)
        assert history == [1, 0, 1, 0, 1, 0, 1]
        assert [entry.actor for entry in await tutti.list_jobs(2)] == [tutti.actor] * 2

    run(main)


def test_the_newest_of_many_targets_is_reached() -> None:
    async def main(tutti: Tutti, records: dict[str, MotorRecord]) -> None:
        x = records["gantry.x"]
        history = follow_dmov(x)
        puts = [begin_put(x, "VAL", 100)]
        for number in range(300):
            puts.append(begin_put(x, "VAL", 20 + number % 70))
            await asyncio.sleep(0.001)
        puts.append(begin_put(x, "VAL", 33))
        assert await asyncio.gather(*puts) == [None] * len(puts)
        assert await tutti.position("gantry.x") == pytest.approx(33, abs=0.002)
        assert history == [1, 0, 1]

    run(main)


def test_axes_of_one_controller_that_are_put_together_are_one_job() -> None:
    async def main(tutti: Tutti, records: dict[str, MotorRecord]) -> None:
        x, y = records["gantry.x"], records["gantry.y"]
        assert await asyncio.gather(begin_put(x, "VAL", 10), begin_put(y, "VAL", 5)) == [None, None]
        assert (await tutti.list_jobs(1))[0].name == "move gantry.x, gantry.y by EPICS"
        first = begin_put(x, "VAL", 60)
        await until(lambda: float(x.values["RBV"]) > 20)
        second = begin_put(y, "VAL", 8)
        await first
        assert y.values["DMOV"] == 0  # behind it
        assert await second is None and await tutti.position("gantry.y") == pytest.approx(8, abs=0.002)

    run(main)


def test_a_refusal_of_one_axis_is_none_of_another_one() -> None:
    async def main(tutti: Tutti, records: dict[str, MotorRecord]) -> None:
        await tutti.home("gantry.y")
        await tutti.enable("gantry")
        x, y = begin_put(records["gantry.x"], "VAL", 10), begin_put(records["gantry.y"], "VAL", 10)
        errors = await asyncio.gather(x, y)
        assert "gantry.x is not referenced" in (errors[0] or "") and errors[1] is None

    with virtual_fleet(EXAMPLES / "demo.fleet.yaml") as fleet:
        fleet.tutti.enable()
        fleet.tutti.home("gantry.y")

        async def serve(tutti: Tutti) -> None:
            async with open_axes(tutti) as axes:
                await main(tutti, {axis.record.axis: axis.record for axis in axes})

        fleet.run(serve)


def test_stop_ends_the_put_where_the_axis_rests() -> None:
    async def main(tutti: Tutti, records: dict[str, MotorRecord]) -> None:
        x, y = records["gantry.x"], records["gantry.y"]
        puts = begin_put(x, "VAL", 200), begin_put(y, "VAL", 200)
        await until(lambda: float(x.values["RBV"]) > 30)
        x.put("STOP", 1, lambda _: None)
        errors = await asyncio.gather(*puts)
        assert errors == [None, "stopped with gantry.x: their controller moves them as one"]
        rest = await tutti.position("gantry.x")
        assert 30 < rest < 100 and x.values["VAL"] == pytest.approx(rest, abs=0.002)
        assert not (await tutti.axes())["gantry.x"].moving
        at_once = begin_put(x, "VAL", 50)
        x.put("STOP", 1, lambda _: None)
        assert await at_once is None and await tutti.position("gantry.x") == pytest.approx(rest, abs=0.5)

    run(main)


def test_pause_and_go() -> None:
    async def main(tutti: Tutti, records: dict[str, MotorRecord]) -> None:
        x = records["gantry.x"]
        put, history = begin_put(x, "VAL", 100), follow_dmov(x)
        await until(lambda: float(x.values["RBV"]) > 30)
        x.put("SPMG", "Pause", lambda _: None)
        await asyncio.sleep(3)
        assert not put.done() and not (await tutti.axes())["gantry.x"].moving
        x.put("SPMG", "Go", lambda _: None)
        assert await put is None and history == [0, 1]
        assert await tutti.position("gantry.x") == pytest.approx(100, abs=0.002)

    run(main)


def test_an_axis_of_another_job_is_refused_and_followed() -> None:
    async def main(tutti: Tutti, records: dict[str, MotorRecord]) -> None:
        x = records["gantry.x"]
        async with tutti.live("gantry.x", name="alignment", speed=0.5) as live:
            assert "alignment" in (await begin_put(x, "VAL", 10) or "")
            assert (x.values["LVIO"], x.values["DMOV"], x.alarm.severity) == (0, 1, 1)
            await live.move({"gantry.x": 70})
        await asyncio.sleep(1)
        assert x.values["VAL"] == 70
        with pytest.raises(JobFailed):
            async with tutti.live("gantry.x", speed=0.2) as live:
                moving = asyncio.ensure_future(live.move({"gantry.x": 300}))
                await asyncio.sleep(1)
                x.put("STOP", 1, lambda _: None)
                await moving

    run(main)


def test_a_jog_stops_before_the_limit() -> None:
    async def main(tutti: Tutti, records: dict[str, MotorRecord]) -> None:
        u = records["stage.u"]
        assert await begin_put(u, "VAL", 45) is None
        assert await begin_put(u, "JOGF", 1) is None
        assert u.values["LVIO"] == 1 and u.values["JOGF"] == 0
        assert 47 < await tutti.position("stage.u") < 50
        jogging = begin_put(u, "JOGR", 1)
        await asyncio.sleep(1)
        assert (await tutti.axes())["stage.u"].moving
        u.put("JOGR", 0, lambda _: None)
        assert await jogging is None and not (await tutti.axes())["stage.u"].moving

    run(main)


def test_offset_home_and_motor() -> None:
    async def main(tutti: Tutti, records: dict[str, MotorRecord]) -> None:
        u = records["stage.u"]
        u.put("SET", "Set", lambda _: None)
        assert await begin_put(u, "VAL", 10) is None
        u.put("SET", "Use", lambda _: None)
        assert u.values["OFF"] == pytest.approx(10, abs=0.1) and u.values["HLM"] == pytest.approx(60, abs=0.1)
        assert await begin_put(u, "DVAL", 3) is None
        assert await tutti.position("stage.u") == pytest.approx(13, abs=0.1)
        assert await begin_put(u, "OFF", 0) is None
        assert await begin_put(u, "CNEN", "Disable") is None and u.values["CNEN"] == 0
        assert "not enabled" in (await begin_put(u, "VAL", 1) or "")
        assert await begin_put(u, "CNEN", 1) is None
        assert await begin_put(u, "HOMF", 1) is None

    run(main)


def test_an_estop_ends_the_put_with_its_reason() -> None:
    async def main(tutti: Tutti, records: dict[str, MotorRecord]) -> None:
        x = records["gantry.x"]
        put = begin_put(x, "VAL", 200)
        await until(lambda: float(x.values["RBV"]) > 30)
        await tutti.estop("a test")
        assert "e-stop" in (await put or "")
        assert "e-stop" in (await begin_put(x, "VAL", 10) or "")
        assert x.values["DMOV"] == 1

    run(main)


def test_a_controller_without_states_is_invalid() -> None:
    async def main(tutti: Tutti) -> None:
        async with open_axes(tutti) as axes:
            (u,) = (axis.record for axis in axes if axis.record.axis == "stage.u")
            await until(lambda: u.alarm.severity == 3)
            assert u.values["STAT"] == 9
            assert await begin_put(u, "VAL", 10) is not None

    with virtual_fleet(EXAMPLES / "demo.fleet.yaml", check=False) as fleet:
        prepare(fleet)
        fleet.fail("stage", "power-off", at="2 s")
        fleet.run(main)
