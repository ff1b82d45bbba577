"""Outputs that are switched with the positions of a stream: what a drive does with them after it has left the stream."""

import asyncio
from typing import Any

import pytest
from unit.adapters.cia402_bench import ACCELERATION, Drives, run
from unit.adapters.test_cia402_stream import SMOOTH, another, followed, smooth

from adapters.cia402.canopen.bus import RPDO
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.can import CanFrame, encode_frames
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import OutputTrigger, StartOptions, TriggerDrive

PULSES = OutputTrigger(output="lamp", instants_ns=[k * 40 * NS_PER_MS for k in range(1, 20)], pulse_ns=20 * NS_PER_MS)
WITH_PULSES = StartOptions(triggers=[PULSES])
SWITCHING: dict[str, Any] = {
    "outputs": {"lamp": {"number": 1}, "valve": {"number": 2}},
    "options": {"quick_stop_acceleration": ACCELERATION, "cycle_us": 100, "output_us": 100},
    **SMOOTH,
}


class Edges:
    """The edges of one output of a drive, host time."""

    def __init__(self, world: Drives, drive: int, output: int = 1) -> None:
        self.all: list[tuple[int, bool]] = []

        def note(number: int, level: bool) -> None:
            if number == output:
                self.all.append((world.clock.now_ns(), level))

        world.units[drive].on_output(note)

    def rises(self) -> list[int]:
        return [at_ns for at_ns, level in self.all if level]


async def released(world: Drives, *numbers: int, start: StartOptions = WITH_PULSES) -> int:
    """Drives armed and released for one T0; T0."""
    t0_ns = world.clock.now_ns() + 200 * NS_PER_MS
    for number in numbers:
        driver = world.drivers[number]
        await driver.slots.present.load(driver.lower_profiles(smooth(0, 40_000), start, None), t0_ns, None)
        await driver.slots.present.verify()
    for number in numbers:
        await world.drivers[number].slots.present.release()
    return t0_ns


async def sync_by_another(world: Drives) -> None:
    """A SYNC from another sender."""
    link = await world.wire.open_link()
    link.write(encode_frames(CanFrame(0x080)))
    await world.rest(50)


# From the SYNC at 280 ms on a pulse is on, or the next one is under way to the drive. A SYNC is written somewhat before.
@pytest.mark.parametrize("when_ms", [269.2, 271, 275, 278.8, 279.5, 281])
def test_a_drive_that_stops_sees_no_active_output_while_another_streams_on(when_ms: float) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        edges, others = Edges(world, 0), Edges(world, 1)
        t0_ns = await released(world, 0, 1)
        following = [asyncio.get_running_loop().create_task(followed(world, number)) for number in (0, 1)]
        await world.until(t0_ns + round(when_ms * NS_PER_MS))
        await world.drivers[0].stop(abort=when_ms == 275)
        stopped_ns = world.clock.now_ns()
        assert [(await each)[1].state for each in following] == ["stopped", "done"]
        # The stop itself makes the output passive, and nothing that was scheduled makes it active again.
        arrived_ns = next(at_ns for at_ns, frame in world.frames if at_ns > stopped_ns and frame.id == RPDO[1] + 1)
        assert not edges.all[-1][1] and edges.all[-1][0] <= arrived_ns + 50_000 <= stopped_ns + 2 * NS_PER_MS
        # No controlword comes with the stream, and none enabled the drive before it stood.
        assert world.units[0].position("1") < 30_000 and world.units[1].position("1") == 40_000
        assert len(others.rises()) == len(PULSES.instants_ns) and not others.all[-1][1]
        switched = (await world.drivers[0].take_triggers())["lamp"]
        for span, at_ns in zip(switched.edges, edges.rises(), strict=False):
            assert span.earliest_ns <= at_ns <= span.latest_ns
        assert len(edges.rises()) - switched.unknown <= len(switched.edges) <= len(edges.rises())
        count = len(edges.all)
        await sync_by_another(world)
        await another(world, 0)
        assert len(edges.all) == count

    run(main, count=2, **SWITCHING)


@pytest.mark.parametrize("way", ["disarmed", "alone", "both", "fault", "late"])
def test_no_output_is_switched_after_any_other_end(way: str) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        edges, valve = Edges(world, 0), Edges(world, 0, 2)
        t0_ns = await released(world, *((0,) if way == "alone" else (0, 1)))
        following = [asyncio.get_running_loop().create_task(followed(world, number)) for number in (0, 1)]
        await world.until(t0_ns - 3 * NS_PER_MS if way == "disarmed" else t0_ns + 279 * NS_PER_MS)
        if way == "disarmed":
            await world.driver.slots.unload()
        elif way == "alone":
            await world.driver.stop(abort=False)
        elif way == "both":
            # The last SYNC of the second one flushes what waits; a position of the first one could not be withdrawn.
            await world.driver.stop(abort=False)
            await world.until(t0_ns + round(280.2 * NS_PER_MS))
            await world.drivers[1].stop(abort=False)
        elif way == "fault":
            world.unit.station.drive.enter_fault(0x4310, 0)
        else:
            # Of what is scheduled from then on; that is an underrun of all drives.
            world.late_ns = lambda at_ns: 4 * NS_PER_MS if at_ns > t0_ns + 285 * NS_PER_MS else 0
        ended_ns = world.clock.now_ns() + (75 if way == "late" else 2) * NS_PER_MS
        await world.rest(500)
        assert bool(edges.all) != (way == "disarmed")
        assert not edges.all or (not edges.all[-1][1] and edges.all[-1][0] <= ended_ns)
        await asyncio.gather(*following, return_exceptions=True)
        # Nor does an older value wait in the drive for a SYNC.
        await world.driver.set_output(2, on=True)
        await sync_by_another(world)
        assert [level for _, level in valve.all] == [True]
        assert not edges.all or edges.all[-1][0] <= ended_ns

    run(main, count=2, **SWITCHING)


@pytest.mark.parametrize("modes", [[1, 6, 8], [1, 6, 7]])
def test_other_outputs_and_trigger_lines_go_with_the_positions(modes: list[int]) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        line, valve = Edges(world, 0), Edges(world, 0, 2)
        drives = StartOptions(drive=TriggerDrive(output="lamp", active_ns=45 * NS_PER_MS))
        t0_ns = await released(world, 0, start=StartOptions())
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 203 * NS_PER_MS)
        await world.driver.set_output(2, on=True)
        assert (await world.driver.slots.present.wait_for_end()).state == "done"
        assert [level for _, level in valve.all] == [True]
        # A drive that does not move drives its line by the same frames.
        t0_ns = world.clock.now_ns() + 200 * NS_PER_MS
        await world.driver.slots.present.load(world.driver.lower_profiles({}, drives, None), t0_ns, None)
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        await world.driver.slots.present.wait_for_end()
        t0_ns = world.clock.now_ns() + 200 * NS_PER_MS
        lowered = world.driver.lower_profiles(smooth(40_000, 0), drives, None)
        await world.driver.slots.present.load(lowered, t0_ns, None)
        await world.driver.slots.present.release()
        with pytest.raises(Refusal, match="a step switches an output"):
            await world.driver.set_output(2, on=False)
        assert (await followed(world))[1].state == "done"
        assert [level for _, level in line.all] == [True, False] * 2
        first, last = lowered.edge_window_ns
        assert first <= line.all[2][0] - t0_ns <= last and line.all[3][0] - line.all[2][0] >= 45 * NS_PER_MS
        assert [level for _, level in valve.all] == [True]
        starts = [frame for _, frame in world.frames if frame.id == RPDO[0] + 1]
        assert starts and all(len(frame.data) == 2 for frame in starts)

    run(main, simulate={"modes": modes}, **SWITCHING)


@pytest.mark.parametrize(("mask", "words"), [(0xFFFE_0000, "does not switch it"), (0xFFFF_0000, "already active")])
def test_an_output_that_cannot_be_switched_is_refused(mask: int, words: str) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        if "active" in words:
            await world.driver.set_output(1, on=True)
        with pytest.raises(Refusal, match=words):
            await released(world, 0)
        assert world.driver.connection.mover.move is None

    run(main, simulate={"objects": {"60FE:2": mask}}, **SWITCHING)
