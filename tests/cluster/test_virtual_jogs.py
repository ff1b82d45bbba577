"""Jogs of virtual axes of a table on three makes: how far the others leave their position, by truth, and what ends
them."""

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from cluster.gateway_client import run_with_gateway
from cluster.test_curved_axes import PREPARE as PREPARE_MONO
from cluster.test_curved_axes import mono_fleet
from cluster.test_gateway import open_gateway
from cluster.test_virtual_axes import PREPARE, SAMPLE_NS, read_truth, table_fleet
from cluster.worlds import demo_fleet, job, outcome, run_fleet

from orchestrator.client.api import Tutti
from orchestrator.client.manual import ManualControl
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.operation.virtual_ramp import VirtualRamp
from orchestrator.runtime.virtual.fleet import VirtualFleet

COUNT_MM = 1 / 2000
VALID_S, POLL_S = 0.2, 0.06
NOTICED_S = 0.5  # by the adapter of a CiA 402 drive
AXES = ("height", "pitch", "roll")


class Seen(NamedTuple):
    """The true positions of the table at an instant."""

    at_ns: int
    table: tuple[float, ...]


class TableWatch:
    """The true positions of the table, every 2 ms, from now on."""

    def __init__(self, fleet: VirtualFleet) -> None:
        self._fleet = fleet
        self.begun = tuple(map(float, read_truth(fleet, "table")))
        self.seen: list[Seen] = []
        self.watching = asyncio.get_running_loop().create_task(self._watch())

    async def _watch(self) -> None:
        while True:
            self.seen.append(Seen(self._fleet.clock.now_ns(), tuple(map(float, read_truth(self._fleet, "table")))))
            await sleep_ns(self._fleet.clock, SAMPLE_NS)

    def off(self, name: str) -> float:
        """How far an axis has been off its first position at most."""
        number = AXES.index(name)
        return max(abs(sample.table[number] - self.begun[number]) for sample in self.seen)

    @property
    def rest_ns(self) -> int:
        """Since when the table is at rest."""
        return next(sample.at_ns for sample in reversed(self.seen) if sample.table != self.seen[-1].table)


async def prepare(fleet: VirtualFleet) -> Tutti:
    await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{table.pitch: 3 mrad, table.roll: -1}}}}]"))
    return fleet.make_client("anna")


async def hold(fleet: VirtualFleet, manual: ManualControl, seconds: float) -> None:
    end_ns = fleet.clock.now_ns() + round(seconds * NS_PER_S)
    while fleet.clock.now_ns() < end_ns:
        await asyncio.sleep(0.05)
        await manual.renew_jog()


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 201))])
def test_the_others_of_the_group_keep_their_positions(seed: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = await prepare(fleet)
        stated = (await client.virtual_states())["table"].jogs["height"]
        watch = TableWatch(fleet)
        async with client.manual_control(["table.height"]) as manual:
            await manual.jog({"table.height": 1.5})
            await hold(fleet, manual, 1.0)
            height = read_truth(fleet, "table")[0]
            await sleep_ns(fleet.clock, NS_PER_S // 20)
            assert float(read_truth(fleet, "table")[0] - height) == pytest.approx(1.5 / 20, rel=1e-3)
            await manual.stop()
            await asyncio.sleep(0.5)
        seconds = (watch.rest_ns - watch.seen[0].at_ns) / NS_PER_S
        for name in ("pitch", "roll"):
            bound = stated.off[name] + stated.drift[name] * seconds
            assert COUNT_MM < watch.off(name) <= bound < stated.deviations[name] == 1, name

    run_fleet(main, table_fleet(), seed)


def test_another_speed_and_the_other_direction_are_reached_by_the_common_ramp() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = await prepare(fleet)
        watch = TableWatch(fleet)
        async with client.manual_control(["table"]) as manual:
            for velocity in (1.5, 0.5, -1.5):
                await manual.jog({"table.height": velocity})
                await hold(fleet, manual, 0.4)
            # One real axis of them cannot be jogged meanwhile.
            with pytest.raises(Refusal, match=r"together; front\.jack, left\.jack, right\.jack moves") as refusal:
                await manual.jog({"front.jack": 0.5})
            assert refusal.value.code == "mixed"
            await manual.stop()
        heights = [sample.table[0] for sample in watch.seen]
        assert max(heights) - watch.begun[0] == pytest.approx(0.8 + 0.1, abs=0.15)
        assert max(heights) - heights[-1] == pytest.approx(0.6 + 0.1, abs=0.15)
        assert watch.off("pitch") < 1 and watch.off("roll") < 1

    run_fleet(main, table_fleet())


async def leave(fleet: VirtualFleet, manual: ManualControl) -> None:
    """Send nothing more."""
    del fleet, manual


async def stop_all(fleet: VirtualFleet, manual: ManualControl) -> None:
    del manual
    await fleet.make_client("carl").stop()


async def estop(fleet: VirtualFleet, manual: ManualControl) -> None:
    del manual
    await fleet.make_client("carl").estop()


async def lose_power(fleet: VirtualFleet, manual: ManualControl) -> None:
    """One controller goes: when its adapter has noticed that, a renewal is refused, which stops the others."""
    fleet.act_on_controller("right", lambda right: right.set_power(on=False))
    with pytest.raises(Refusal):
        await hold(fleet, manual, 5)


@pytest.mark.parametrize(
    ("act", "rests_s"), [(leave, VALID_S), (stop_all, 0.05), (estop, 0.05), (lose_power, NOTICED_S)]
)
def test_all_real_axes_stop_whatever_ends_a_jog(
    act: Callable[[VirtualFleet, ManualControl], Awaitable[None]], rests_s: float
) -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = await prepare(fleet)
        watch = TableWatch(fleet)
        manual = client.manual_control(["table.height"])
        await manual.acquire()
        await manual.jog({"table.height": 1.5})
        await hold(fleet, manual, 0.5)
        begun_ns = fleet.clock.now_ns()
        await act(fleet, manual)
        await asyncio.sleep(1.5)
        ramp_s = 1.5 / 50
        assert (watch.rest_ns - begun_ns) / NS_PER_S <= rests_s + POLL_S + ramp_s
        await manual.release()

    run_fleet(main, table_fleet())


def test_what_cannot_be_jogged_is_refused_by_name() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = await prepare(fleet)
        async with client.manual_control(["table", "slit"]) as manual:
            for velocities, code, words in (
                (
                    {"table.height": 1.6},
                    "too-fast",
                    r"table\.height may jog at 1\.5 mm/s at most, where table\.pitch is off",
                ),
                ({"table.height": 1.0, "table.pitch": 5.0}, "too-fast", "together with table.height"),
                ({"slit.gap": 1.0, "front.upper": 1.0}, "mixed", "cannot be jogged together"),
                ({"table.hight": 1.0}, "unknown-axis", "table has the axes height, pitch, roll"),
                ({"tabel.height": 1.0}, "absent", "tabel"),
            ):
                with pytest.raises(Refusal, match=words) as refusal:
                    await manual.jog(velocities)
                assert refusal.value.code == code
            assert not any(fleet.controllers["front"].is_moving(motor) for motor in "XYZ")
        async with client.manual_control(["slit"]) as manual:
            with pytest.raises(Refusal) as refusal:
                await manual.jog({"table.height": 1.0})
            assert refusal.value.code == "not-leased"

    run_fleet(main, table_fleet())


def test_a_jog_ends_at_the_first_soft_limit() -> None:
    """All real axes slow down together before it, and the table stays level."""

    async def main(fleet: VirtualFleet) -> None:
        client = await prepare(fleet)
        await outcome(fleet, job("[{do: move, to: {slit.gap: 9, slit.centre: 0, table.height: 14}}]"))
        watch = TableWatch(fleet)
        ends = {"table.height": 15, "slit.gap": 10}
        for axis, velocity in (("table.height", 1.5), ("slit.gap", 2.0)):
            group = axis.partition(".")[0]
            async with client.manual_control([axis]) as manual:
                await manual.jog({axis: velocity})
                with pytest.raises(Refusal, match=f"axis {axis} is at the soft limit of {axis}"):
                    await hold(fleet, manual, 10)
                with pytest.raises(Refusal, match="jog in the other direction"):
                    await manual.jog({axis: velocity})
                reached = float(read_truth(fleet, group)[0])
                await manual.jog({axis: -velocity})
            assert ends[axis] - 0.02 <= reached <= ends[axis]
        assert 15 - 0.02 <= max(sample.table[0] for sample in watch.seen) <= 15
        assert watch.off("pitch") < 1 and watch.off("roll") < 1

    run_fleet(main, table_fleet())


def test_a_curved_axis_is_jogged_by_its_derivative() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE_MONO}, {{do: move, to: {{mono.energy: 8}}}}]"))
        client = fleet.make_client()
        async with client.manual_control(["mono.energy"]) as manual:
            begun = await client.position("mono.energy")
            await manual.jog({"mono.energy": 0.1})
            await hold(fleet, manual, 2.0)
            await manual.stop()
        await asyncio.sleep(0.5)
        assert await client.position("mono.energy") - begun == pytest.approx(0.2, rel=0.05)

    run_fleet(main, mono_fleet())


def test_a_page_jogs_a_virtual_axis_by_its_frames(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet)
        watch = TableWatch(fleet)
        _, socket = await open_gateway(fleet, tmp_path)
        assert "front.jack" in str(await socket.ask("acquire", axes=["table.height"]))
        assert (await socket.ask("jog", axis="table.pitch", velocity=1))["refused"]["code"] == "not-leased"
        for verb, fields in (("jog", {"axis": "table.height", "velocity": 1.5}), *[("renew", {})] * 10):
            assert "ok" in await socket.ask(verb, **fields)
            await asyncio.sleep(0.1)
        assert fleet.controllers["left"].is_moving("X")
        let_go_ns = fleet.clock.now_ns()
        socket.send("end-jog")
        await asyncio.sleep(0.5)
        assert (watch.rest_ns - let_go_ns) / NS_PER_S < VALID_S
        assert watch.seen[-1].table[0] - watch.begun[0] > 1.0
        assert watch.off("pitch") < 1 and watch.off("roll") < 1

    run_with_gateway(main, table_fleet())


def test_a_make_that_rests_for_each_speed_is_refused_by_name() -> None:
    plain = demo_fleet().to_plain()
    of = ["gantry.x", "stage.u"]
    plain["virtual"] = {
        "pair": {"kind": "rotation", "of": of, "angle": 30, "axes": {"u": {"unit": "mm"}, "v": {"unit": "mm"}}}
    }

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        async with client.manual_control(["pair"]) as manual:
            with pytest.raises(Refusal, match=r"stage \(shrc203\) changes the speed of a jog only at rest"):
                await manual.jog({"pair.u": 0.1})

    run_fleet(main, Fleet.model_validate(plain))


def test_without_the_common_ramp_the_others_leave_the_stated_deviation(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutation: all of a speed is sent at once, and each real axis has its own ramp to it."""
    monkeypatch.setattr(VirtualRamp, "_find_share", lambda *_: 1.0)

    async def main(fleet: VirtualFleet) -> None:
        client = await prepare(fleet)
        stated = (await client.virtual_states())["table"].jogs["height"]
        watch = TableWatch(fleet)
        async with client.manual_control(["table.height"]) as manual:
            await manual.jog({"table.height": 1.5})
            await hold(fleet, manual, 0.5)
            await manual.stop()
            await asyncio.sleep(0.5)
        seconds = (watch.rest_ns - watch.seen[0].at_ns) / NS_PER_S
        assert watch.off("pitch") > stated.off["pitch"] + stated.drift["pitch"] * seconds

    slow = table_fleet().to_plain()
    slow["controllers"]["left"]["axes"]["jack"]["limits"]["acceleration"] = 2
    run_fleet(main, Fleet.model_validate(slow))
