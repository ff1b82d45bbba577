"""A move and its follow-up move: how they are chosen, and how the simulated controller executes them under all
conditions."""

import asyncio
from collections.abc import Mapping
from random import Random
from typing import Any

import pytest
from unit.adapters.restarts import sees_the_restart
from unit.adapters.test_shrc203_driver import NAMES, Bench, controller, run
from unit.adapters.test_shrc203_lowering import controller as one_axis
from unit.adapters.test_shrc203_lowering import wire
from unit.random_rounds import share_with_nightly

from adapters.contract import HostInterval, MoveOutcome
from adapters.shrc203 import MAKE
from adapters.shrc203.lowering import ConnectionTraits, ShrcLowered, lower_step
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.shapes.pair import FIRST_S, TwoPartMove, find_two_part_moves
from adapters.shrc203.shapes.trapezoid import ShrcBounds
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions, TriggerWait
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step

INPUTS: dict[str, Any] = {"inputs": {"start": {"number": 2}}}
WAIT = StartOptions(wait=TriggerWait(input="start", earliest_ns=-2 * NS_PER_MS, latest_ns=3 * NS_PER_MS))
SLOW = {"x": 612, "y": -333, "z": 505}
SLOW_S = 39.9  # no single move of any of them takes it


def planned(
    start: Mapping[str, int], way: Mapping[str, int], duration_s: float = SLOW_S, acceleration: float = 300.0
) -> Mapping[str, Profile]:
    moves = [AxisMove(name, start[name], start[name] + each, 90.0, acceleration) for name, each in way.items()]
    plan = plan_step(moves)
    return plan.stretch_to(duration_s).profiles


async def armed(bench: Bench, way: Mapping[str, int], how: StartOptions | None = None) -> tuple[ShrcLowered, int]:
    now = (await bench.driver.poll()).axes
    profiles = planned({name: axis.commanded_counts for name, axis in now.items()}, way)
    made = bench.driver.lower_profiles(profiles, how or StartOptions(), None)
    t0_ns = bench.clock.now_ns() + 700 * NS_PER_MS
    await bench.driver.slots.present.load(made, t0_ns, None)
    return made, t0_ns


async def released(bench: Bench, way: Mapping[str, int], how: StartOptions | None = None) -> tuple[ShrcLowered, int]:
    made, t0_ns = await armed(bench, way, how)
    await bench.driver.slots.present.verify()
    await bench.driver.slots.present.release()
    if how is not None:
        bench.clock.call_at_ns(t0_ns, lambda: bench.unit.set_input(2, level=True))
    return made, t0_ns


async def followed(bench: Bench) -> tuple[Mapping[str, HostInterval], MoveOutcome]:
    started = await bench.driver.slots.present.wait_for_start()
    return started, await bench.driver.slots.present.wait_for_end()


async def nothing_is_left(bench: Bench) -> None:
    """Nothing moves any more, even if another client sends `G` or switches the inputs."""
    for _ in range(2):
        await bench.driver.poll()
    await bench.driver.slots.unload()
    count = len(bench.moved())
    await bench.driver.send_raw("G")
    for number in range(1, 7):
        bench.unit.set_input(number, level=number == 2)
    await sleep_ns(bench.clock, 2 * NS_PER_S)
    assert bench.unit.at_rest() and len(bench.moved()) == count


# The choice


@pytest.mark.parametrize("seed", share_with_nightly(range(4), 2))
def test_slow_moves_take_the_planned_time_within_all_limits(seed: int) -> None:
    draw = Random(seed)
    split = 0
    for _ in range(40):
        start = draw.choice([1, 2, 4]), draw.choice([5, 30, 400])
        acceleration = draw.choice([100.0, 500.0, 5000.0])
        config = one_axis(
            scale=1000,
            limits={"velocity": 0.5, "acceleration": acceleration / 1000},
            start_rate={"min": start[0] / 1000, "max": start[1] / 1000},
        )
        way, duration_s = draw.randrange(300, 3000) * draw.choice([1, -1]), draw.uniform(30, 60)
        profile = planned({"x": 0}, {"x": way}, duration_s, acceleration)["x"]
        options = ShrcOptions(handover_us=draw.choice([0, 1000, 7000]))
        made = lower_step(config, options, wire(options, 260_000), {"x": profile}, StartOptions())
        assert abs(made.durations_s["x"] - duration_s) <= 0.2e-3
        (move,) = made.moves
        assert sum(each.distance for each in move.executed_moves) == way
        if not isinstance(move.shape, TwoPartMove):
            assert not made.followup_moves and not made.load_followup
            continue
        split += 1
        assert made.commands == (made.load, made.start, made.load_followup)
        assert move.shape.first.duration_s >= FIRST_S
        for each in (move.shape.first, move.shape.second):
            assert 1 <= start[0] <= each.s <= start[1] and each.s <= each.f <= 500 and 1 <= each.r <= 1000
            assert each.acceleration <= acceleration * (1 + 1e-6)
        if split > 4:
            continue
        worst = farthest(profile, move.shape)
        assert worst <= made.path_error_counts["x"] < worst + 1.5
    assert split > 5


def farthest(profile: Profile, shape: TwoPartMove) -> float:
    """The largest distance to the plan, by looking at many instants."""
    worst, sign = 0.0, 1 if profile.end_counts > profile.start_counts else -1
    for k in range(2000):
        t = at_s = k / 2000 * profile.duration_s
        x = 0.0
        for leg in shape.motion_legs:
            step = min(t, leg.duration_s)
            x += step * (leg.speed + step * leg.acceleration / 2)
            t -= step
        worst = max(worst, abs(sign * x - (profile.state_at(at_s).position - profile.start_counts)))
    return worst


def test_of_all_pairs_with_the_duration_the_nearest_to_the_plan_is_chosen() -> None:
    config, options = one_axis(scale=1000, limits={"velocity": 0.5, "acceleration": 5}), ShrcOptions()
    profile = planned({"x": 0}, {"x": 1500}, 63.3)["x"]
    made = lower_step(config, options, wire(options, 260_000), {"x": profile}, StartOptions())
    found = find_two_part_moves(1500, 63.3, ShrcBounds(500, 5000, 1, 5), options.handover_us * 1e-6)
    ways = [farthest(profile, each) for each in found]
    assert len(found) > 3 and max(ways) > min(ways) + 1
    assert made.path_error_counts["x"] < min(ways) + 1.5


def test_one_move_is_preferred_and_required_if_the_scale_has_to_settle() -> None:
    config, options = one_axis(scale=1000, limits={"velocity": 0.5, "acceleration": 5}), ShrcOptions()
    open_loop = wire(options, 260_000)
    closed_loop = ConnectionTraits(
        260_000, True, open_loop.costs, open_loop.line_costs, open_loop.known, frozenset({1})
    )
    for duration_s, length in ((6.2, 1), (SLOW_S, 2)):
        profile = planned({"x": 0}, {"x": 612}, duration_s)["x"]
        made = lower_step(config, options, open_loop, {"x": profile}, StartOptions())
        assert len(made.moves[0].executed_moves) == length
        made = lower_step(config, options, closed_loop, {"x": profile}, StartOptions())
        assert len(made.moves[0].executed_moves) == 1


# The execution by the controller


@pytest.mark.parametrize("how", [None, WAIT], ids=["host", "line"])
@pytest.mark.parametrize("seed", range(5))
def test_both_moves_run_and_end_when_predicted(seed: int, how: StartOptions | None) -> None:
    async def case(bench: Bench) -> None:
        draw, crystal = Random(seed), 1 + ppm * 1e-6
        await bench.ready()
        way = {name: SLOW[name] * draw.choice([1, -1]) for name in draw.sample("xyz", draw.randint(1, 3))}
        made, t0_ns = await released(bench, way, how)
        assert {each.name for each in made.followup_moves} == set(way)
        started, outcome = await followed(bench)
        assert outcome.state == "done", outcome
        early_ns, late_ns = made.window_ns
        for name, distance in way.items():
            first, second = (each for each in bench.moved() if each.axis == NAMES[name])
            assert second.end_counts == distance and first.end_ns is not None and second.end_ns is not None
            assert early_ns <= first.start_ns - t0_ns <= late_ns
            assert started[name].earliest_ns <= first.start_ns <= started[name].latest_ns
            assert outcome.ended[name].earliest_ns <= second.end_ns <= outcome.ended[name].latest_ns
            took_s = (second.end_ns - first.start_ns) * 1e-9 * crystal
            assert took_s == pytest.approx(made.durations_s[name], abs=0.1e-3)
            assert made.durations_s[name] == pytest.approx(SLOW_S, abs=0.2e-3)
        await nothing_is_left(bench)

    ppm = Random(seed).uniform(-95, 95)
    config = controller("xyz", **INPUTS)
    run(case, seed=seed, config=config, ppm=ppm, hold_ns=seed % 2 * 16 * NS_PER_MS)


@pytest.mark.parametrize("how", [None, WAIT], ids=["host", "line"])
@pytest.mark.parametrize(
    "simulate",
    [
        {"handover_ms": 0},
        {"handover_ms": 9},
        {"standby_completion": True, "standby_reply_deferred": True},
        {"completion_after_stop": False, "stop_keeps_prebuffer": True},
        {"controllable": [1]},
    ],
    ids=str,
)
def test_controllers_of_other_readings(simulate: dict[str, Any], how: StartOptions | None) -> None:
    """The bounds hold for any duration of the hand-over; with `handover_us` measured the duration is right, too."""

    async def case(bench: Bench) -> None:
        await bench.ready()
        made, _ = await released(bench, {"x": 612}, how)
        started, outcome = await followed(bench)
        assert outcome.state == "done", outcome
        first, second = bench.moved()
        assert second.end_counts == 612 and second.end_ns is not None
        assert started["x"].earliest_ns <= first.start_ns <= started["x"].latest_ns
        assert outcome.ended["x"].earliest_ns <= second.end_ns <= outcome.ended["x"].latest_ns
        off_s = (second.end_ns - first.start_ns) * 1e-9 - made.durations_s["x"]
        assert abs(off_s) <= (0.1e-3 if measured else 10e-3)

    handover_us = simulate.get("handover_ms", 1) * 1000
    config = controller("x" if "controllable" in simulate else "xyz", **INPUTS)
    for measured in (False, True):
        run(case, config=config, simulate=simulate, options={"handover_us": handover_us} if measured else {})


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("after_us", [-3000, 0, 2000, 8000, 30_000, 60_000, 5_000_000, "before", "between", "behind"])
def test_a_stop_at_any_moment_leaves_nothing_that_moves(after_us: int | str, abort: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        made, t0_ns = await released(bench, {"x": 612, "y": -333})
        change_us = round(first_s(made) * 1e6)
        places = {"before": change_us - 1500, "between": change_us + 300, "behind": change_us + 2000}
        at_ns = t0_ns + (places[after_us] if isinstance(after_us, str) else after_us) * NS_PER_US
        following = asyncio.get_running_loop().create_task(followed(bench))
        await sleep_ns(bench.clock, at_ns - bench.clock.now_ns())
        written: list[bytes] = []
        bench.wire.to_far = lambda data: written.append(data) or data
        await bench.driver.stop(abort=abort)
        # The effect of `L:` on a prebuffer is not documented: it is overwritten first.
        assert written[0].startswith(b"L:E" if abort else b"MP:1+P0\r\nMP:2+P0\r\nL:")
        try:
            _, outcome = await following
        except ControllerFault:  # it was not even started
            assert after_us in (-3000, 0, 2000)
        else:
            assert outcome.state == ("fault" if abort else "stopped"), outcome
        assert bench.clock.now_ns() < at_ns + 2 * NS_PER_S
        if abort:
            await bench.driver.clear_faults()
            await bench.driver.set_enabled(["x", "y"], on=True)
        await nothing_is_left(bench)

    run(case, simulate={"stop_keeps_prebuffer": True})


def first_s(made: ShrcLowered) -> float:
    """How long the first of two moves of the first axis takes."""
    shape = made.first_moves[0].shape
    assert shape is not None
    return shape.duration_s


def test_a_guardian_that_stops_between_leaves_nothing_that_moves() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await released(bench, {"x": 612})
        await bench.driver.slots.present.wait_for_start()
        following = asyncio.get_running_loop().create_task(bench.driver.slots.present.wait_for_end())
        await sleep_ns(bench.clock, NS_PER_S)
        link = await bench.wire.open_link()
        link.write(MAKE.stop_bytes(bench.config))
        await sleep_ns(bench.clock, NS_PER_S)
        assert bench.unit.at_rest()
        await bench.driver.poll()
        assert (await following).state == "fault"
        await nothing_is_left(bench)

    run(case, simulate={"stop_keeps_prebuffer": True})


# What goes wrong


@pytest.mark.parametrize("harm", [(b"MP:", b"MQ:"), (b"+P", b"+P9")], ids=["refused", "another distance"])
@pytest.mark.parametrize("times", [1, 2])
def test_a_rejected_follow_up_move_stops_the_step_unless_its_repetition_is_accepted(
    harm: tuple[bytes, bytes], times: int
) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        made, _ = await released(bench, {"x": 612, "y": -333})
        left = times

        def garbled(data: bytes) -> bytes:
            nonlocal left
            if made.load_followup.encode() not in data or not left:
                return data
            left -= 1
            return data.replace(*harm)

        bench.wire.to_far = garbled
        started, outcome = await followed(bench)
        assert not left and set(started) == {"x", "y"}
        if times == 1:
            assert outcome.state == "done"
        else:
            assert outcome.state == "fault" and "follow-up move could not be loaded" in outcome.reason
            assert all(abs(bench.unit.position(number)) < 60 for number in "12")
        await nothing_is_left(bench)

    run(case, simulate={"stop_keeps_prebuffer": True})


def test_a_follow_up_move_that_comes_too_late_is_reported_and_not_run() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        made, _ = await released(bench, {"x": 612})
        await bench.driver.slots.present.wait_for_start()
        await sleep_ns(bench.clock, round(first_s(made) * NS_PER_S) + NS_PER_S)  # the host is frozen
        outcome = await bench.driver.slots.present.wait_for_end()
        assert outcome.state == "fault" and "the follow-up move came too late" in outcome.reason, outcome
        (motion,) = bench.moved()
        assert motion.end_counts == made.first_moves[0].end_counts
        await nothing_is_left(bench)
        await released(bench, {"x": 700 - made.first_moves[0].end_counts})
        assert (await followed(bench))[1].state == "done"

    run(case)


@pytest.mark.parametrize("loaded", [False, True])
def test_a_cut_link_leaves_the_axis_at_the_end_of_its_loaded_moves(loaded: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        made, _ = await released(bench, {"x": 612})
        await bench.driver.slots.present.wait_for_start()
        following = asyncio.get_running_loop().create_task(bench.driver.slots.present.wait_for_end())
        if loaded:
            await sleep_ns(bench.clock, NS_PER_S)
        bench.wire.links[-1].hang_up()
        with pytest.raises(LinkClosed):
            await following
        await sleep_ns(bench.clock, 50 * NS_PER_S)
        assert bench.unit.at_rest()
        assert bench.unit.position("1") == (612 if loaded else made.first_moves[0].end_counts)
        await bench.driver.close()
        await bench.ready()
        await nothing_is_left(bench)

    run(case)


def test_a_link_that_loses_everything_while_the_follow_up_move_is_loaded_ends_in_a_fault() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await released(bench, {"x": 612})
        await bench.driver.slots.present.wait_for_start()
        bench.wire.cut = True
        with pytest.raises(ControllerFault):
            await bench.driver.slots.present.wait_for_end()
        bench.wire.cut = False
        await bench.driver.stop(abort=False)
        await sleep_ns(bench.clock, NS_PER_S)
        await nothing_is_left(bench)

    run(case)


@pytest.mark.parametrize("at_s", [0.5, 39.0])
def test_a_power_cut_is_a_fault(at_s: float) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        _, t0_ns = await released(bench, {"x": 612})
        await bench.driver.slots.present.wait_for_start()
        following = asyncio.get_running_loop().create_task(bench.driver.slots.present.wait_for_end())
        await sleep_ns(bench.clock, t0_ns + round(at_s * NS_PER_S) - bench.clock.now_ns())
        bench.wire.links[-1].write(b"RESET:\r\n")
        outcome = await following
        assert outcome.state == "fault", outcome
        await sees_the_restart(bench.driver)
        await nothing_is_left(bench)

    run(case)


def test_a_limit_sensor_in_the_first_move_ends_the_step() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        _, t0_ns = await released(bench, {"x": 612})
        bench.clock.call_at_ns(t0_ns + NS_PER_S, lambda: bench.unit.set_limit("1", "forward"))
        await bench.driver.slots.present.wait_for_start()
        following = asyncio.get_running_loop().create_task(bench.driver.slots.present.wait_for_end())
        await sleep_ns(bench.clock, 3 * NS_PER_S)
        await bench.driver.poll()
        outcome = await following
        assert outcome.state == "fault" and "limit sensor" in outcome.reason
        await nothing_is_left(bench)

    run(case, simulate={"stop_keeps_prebuffer": True})


@pytest.mark.parametrize("lost", [1, 2])
def test_a_lost_completion_line_is_recovered_by_a_poll(lost: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await released(bench, {"x": 612})
        seen = 0

        def without(data: bytes) -> bytes:
            nonlocal seen
            seen += data == b"1\r\n"
            return b"" if data == b"1\r\n" and seen == lost else data

        bench.wire.to_near = without
        _, outcome = await followed(bench)
        assert outcome.state == "done" and seen == 2
        _, second = bench.moved()
        assert second.end_ns is not None
        assert outcome.ended["x"].earliest_ns <= second.end_ns <= outcome.ended["x"].latest_ns
        await nothing_is_left(bench)

    run(case)


@pytest.mark.parametrize("end", ["disarm", "stop"])
@pytest.mark.parametrize("how", [None, WAIT], ids=["host", "line"])
def test_a_move_that_is_withdrawn_before_its_start_never_moves(end: str, how: StartOptions | None) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await armed(bench, SLOW, how)
        if end == "stop":
            await bench.driver.stop(abort=False)
        await nothing_is_left(bench)
        assert not bench.moved()
        with pytest.raises(Refusal):
            await bench.driver.slots.present.release()

    run(case, config=controller("xyz", **INPUTS))


@pytest.mark.parametrize("seed", range(6))
def test_a_noisy_line_moves_no_axis_beyond_its_target(seed: int) -> None:
    """One byte in about 100 is garbled, both ways, from the start on."""

    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()
        at = 0
        for _ in range(3):
            way = draw.choice([612, -555, 333])
            made, _ = await released(bench, {"x": way})
            await bench.driver.slots.present.wait_for_start()
            bench.wire.to_far = bench.wire.to_near = lambda data: bytes(
                draw.randrange(256) if draw.random() < 0.01 else each for each in data
            )
            try:
                state = (await bench.driver.slots.present.wait_for_end()).state
            except ControllerFault:
                state = "fault"
            bench.wire.to_far = bench.wire.to_near = None
            await bench.driver.stop(abort=False)
            await sleep_ns(bench.clock, NS_PER_S)
            now = bench.unit.position("1")
            assert min(at, at + way) <= now <= max(at, at + way)
            assert now == made.moves[0].end_counts or state != "done"
            await nothing_is_left(bench)
            at = round(now)

    run(case, seed=seed)
