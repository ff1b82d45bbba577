"""Positions with the interval in which they were read: in states as they come, and in the report of a move."""

import asyncio
import json
from collections.abc import Mapping, Sequence
from random import Random

import pytest
from cluster.worlds import EXAMPLES

from orchestrator.bus.base import Priority
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.utc import parse_utc_ns
from orchestrator.model.names import split_name
from tutti import ReadPosition, Refusal, StateReading, TimeInterval, Tutti
from tutti.testing import VirtualTestbed, virtual_fleet

DEMO = EXAMPLES / "demo.fleet.yaml"
GEARS = {"ppsmc": 1000}  # its simulator's truth is in degrees, not in steps
GEARS = {"ppsmc": 1000}  # its simulator's motors count degrees, its axes steps
MODELLED = ("smc30",)  # its position in motion is that of its plan: it answers none


def true_positions(fleet: VirtualTestbed, axis: str, read: TimeInterval, parts: int = 40) -> list[float]:
    """Where an axis truly was in an interval of fleet time."""
    gear = GEARS.get(fleet.fleet.controllers[split_name(axis)[0]].adapter, 1)
    width_ns = read.latest_ns - read.earliest_ns
    return [
        gear * fleet.truth(axis).position_at((read.earliest_ns + width_ns * n / parts) / NS_PER_S)
        for n in range(parts + 1)
    ]


def misread(fleet: VirtualTestbed, axis: str, position: float, read: TimeInterval) -> float:
    """How far a position is from where the axis truly was within its interval, in counts."""
    places, scale = true_positions(fleet, axis, read), float(fleet.fleet.axis(axis).scale)
    return max(0.0, min(places) - position, position - max(places)) * abs(scale)


async def follow(tutti: Tutti, axes: Sequence[str] | None, taken: list[StateReading]) -> None:
    """Take states until the task is cancelled."""
    async for state in tutti.states(axes):
        taken.append(state)


async def follow_moves(tutti: Tutti, targets: Sequence[Mapping[str, float]]) -> list[StateReading]:
    """Follow the states of the moved axes during moves."""
    taken: list[StateReading] = []
    task = asyncio.create_task(follow(tutti, list(targets[0]), taken))
    for target in targets:
        await tutti.move(dict(target))
    task.cancel()
    return taken


@pytest.mark.parametrize(
    "name", ["demo", "smc4000", "smc2000", "shrc203", "ppsmc", "smc30", "cia402", "galil", "chain"]
)
def test_a_position_was_true_within_its_interval(name: str) -> None:
    with virtual_fleet(EXAMPLES / f"{name}.fleet.yaml") as fleet:
        fleet.tutti.enable()
        fleet.tutti.home()
        axes = list(fleet.fleet.axis_names)[:4]
        infos = [fleet.tutti.axis(axis) for axis in axes]
        target = {info.name: 0.1 * min(info.most or 100.0, 100 * info.velocity) for info in infos}
        back = {axis: position / 2 for axis, position in target.items()}
        taken = fleet.run(lambda tutti: follow_moves(tutti, [target, back]))
        moving = 0
        for state in taken:
            make = fleet.fleet.controllers[state.controller].adapter
            assert state.read is not None and state.missed == 0
            for axis, axis_now in state.axes.items():
                moving += axis_now.moving
                if make not in MODELLED or not axis_now.moving:
                    assert misread(fleet, axis, axis_now.commanded, state.read) <= 1.01, (axis, state)
        assert moving > 3


def test_states_come_once_each_with_utc_of_their_reading() -> None:
    with virtual_fleet(DEMO) as fleet:
        fleet.tutti.enable()
        fleet.tutti.home()
        taken = fleet.run(lambda tutti: follow_moves(tutti, [{"gantry.x": 50, "stage.u": 3}]))
        for controller in ("gantry", "stage"):
            intervals = [state.read for state in taken if state.controller == controller]
            middles_ns = [(read.earliest_ns + read.latest_ns) // 2 for read in intervals if read is not None]
            assert len(middles_ns) == len(intervals) and middles_ns == sorted(middles_ns)
        assert {axis for state in taken for axis in state.axes} == {"gantry.x", "stage.u"}
        assert not any(state.missed for state in taken)
        # Fleet time and UTC advance alike, so that an event has one instant.
        offsets_ns = {
            parse_utc_ns(state.utc) - (state.read.earliest_ns + state.read.latest_ns) // 2
            for state in taken
            if state.read is not None
        }
        assert max(offsets_ns) - min(offsets_ns) <= 2000


def test_a_consumer_that_does_not_read_gets_the_newest_and_delays_no_other() -> None:
    async def main(tutti: Tutti) -> tuple[StateReading, StateReading, list[StateReading]]:
        slow, taken = tutti.states(["gantry.x"]), list[StateReading]()
        first = await anext(slow)
        task = asyncio.create_task(follow(tutti, ["gantry.x"], taken))
        await asyncio.sleep(60)
        second = await anext(slow)
        newest = [await anext(slow) for _ in range(2)][-1]
        task.cancel()
        await slow.aclose()
        assert newest.missed == 0
        return first, second, taken

    with virtual_fleet(DEMO) as fleet:
        first, second, taken = fleet.run(main)
        assert first.missed == 0 and second.missed >= 100 and second.read is not None
        assert len(taken) > 250 and not any(state.missed for state in taken)
        # It goes on with what came last before it read, but for what could wait for it.
        last = taken[-1]
        assert last.read is not None and last.read.latest_ns - second.read.latest_ns < 25 * NS_PER_S


def test_states_lost_on_the_way_are_counted() -> None:
    async def main(tutti: Tutti) -> int:
        states = tutti.states(["gantry.x"])
        await anext(states)
        before = await anext(states)
        state = (await tutti.status())["gantry"]
        later = state.model_copy(update={"seq": state.seq + 8})
        tutti.bus.put(tutti.keys.state("gantry"), later.to_json(), Priority.STATE)
        while before.missed == 0:
            before = await anext(states)
        await states.aclose()
        return before.missed

    with virtual_fleet(DEMO) as fleet:
        assert fleet.run(main) == 7


@pytest.mark.parametrize(
    ("axes", "code", "words"),
    [
        (["gantry.xx"], "unknown-axis", "gantry.x"),
        (["gantry"], "unknown-axis", "gantry.x"),
        (["gantry.x", "Stage.u"], "unknown-axis", "stage.u"),
        ("stage.uu", "unknown-axis", "stage.u"),
        ([""], "unknown-axis", "gantry.x"),
        ([], "no-axes", "no axis"),
    ],
)
def test_wrong_axes_are_refused(axes: Sequence[str], code: str, words: str) -> None:
    with virtual_fleet(DEMO) as fleet:
        with pytest.raises(Refusal) as caught:
            next(fleet.tutti.states(axes))
        assert caught.value.code == code and words in caught.value.text and caught.value.remedy


def test_a_closed_connection_ends_the_states_with_a_message() -> None:
    async def main(tutti: Tutti) -> Refusal:
        task = asyncio.create_task(follow(tutti, None, []))
        await asyncio.sleep(1)
        await tutti.close()
        with pytest.raises(Refusal) as caught:
            await task
        return caught.value

    with virtual_fleet(DEMO) as fleet:
        refusal = fleet.run(main)
        assert refusal.code == "closed" and refusal.remedy


def test_states_of_an_offline_controller_have_no_interval_and_go_on() -> None:
    async def main(tutti: Tutti) -> list[StateReading]:
        taken: list[StateReading] = []
        async for state in tutti.states(["gantry.x"]):
            taken.append(state)
            if state.mode != "offline" and any(before.mode == "offline" for before in taken):
                break
        return taken

    with virtual_fleet(DEMO) as fleet:
        fleet.fail("gantry", "link-cut", at="1 s", until="4 s")
        taken = fleet.run(main)
        assert all((state.read is None) == (state.mode == "offline") for state in taken)


@pytest.mark.parametrize("scans", [1, pytest.param(10, marks=pytest.mark.nightly)])
def test_no_event_has_the_position_of_another_point(scans: int) -> None:
    """Scans of 50 points by a client that moves from point to point, as a RunEngine does, and takes the positions
    of each event from the report of its move."""
    draws = Random("events")

    async def scan(tutti: Tutti) -> list[tuple[float, Mapping[str, ReadPosition]]]:
        events: list[tuple[float, Mapping[str, ReadPosition]]] = []
        for _ in range(50):
            target = float(draws.randrange(10, 1000)) / 10
            (step,) = (await tutti.move({"gantry.x": target, "stage.u": target / 20})).steps
            events.append((target, step.positions))
        return events

    with virtual_fleet(DEMO) as fleet:
        fleet.tutti.enable()
        fleet.tutti.home()
        for _ in range(scans):
            for target, positions in fleet.run(scan):
                assert set(positions) == {"gantry.x", "stage.u"}
                for axis, wanted in (("gantry.x", target), ("stage.u", target / 20)):
                    read = positions[axis]
                    assert read.position == pytest.approx(wanted, abs=0.003), (axis, wanted, read)
                    assert misread(fleet, axis, read.position, read.read) <= 1.01


def test_a_move_to_where_the_axes_are_has_their_positions() -> None:
    with virtual_fleet(DEMO) as fleet:
        fleet.tutti.enable()
        fleet.tutti.home()
        fleet.tutti.move({"gantry.x": 20})
        (step,) = fleet.tutti.move({"gantry.x": 20}).steps
        assert step.reason == "already there" and step.positions["gantry.x"].position == pytest.approx(20, abs=0.002)


def test_a_state_without_an_interval_is_read() -> None:
    """Of an adapter that does not state it: its controller has positions, and none of them has an instant."""

    async def main(tutti: Tutti) -> StateReading:
        states = tutti.states(["gantry.x"])
        now = await anext(states)
        state = (await tutti.status())["gantry"]
        plain = {name: value for name, value in state.to_plain().items() if name != "read_within"} | {"seq": 10**6}
        tutti.bus.put(tutti.keys.state("gantry"), json.dumps(plain).encode(), Priority.STATE)
        while now.missed == 0:
            now = await anext(states)
        await states.aclose()
        return now

    with virtual_fleet(DEMO) as fleet:
        reading = fleet.run(main)
        assert reading.read is None and reading.utc and "gantry.x" in reading.axes
