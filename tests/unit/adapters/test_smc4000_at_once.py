"""A move of an SMC-4000 that begins as soon as the one before has ended, against the simulated controller in virtual
time."""

from typing import Any, cast

import pytest
from unit.adapters.test_smc4000_behind import Pair, run_pair
from unit.adapters.test_smc4000_bench import trapezoid

from adapters.contract import HostInterval
from adapters.yaskawa.common.gate import AT_ONCE_LATEST_NS, GateTiming
from adapters.yaskawa.common.loads import YaskawaLowered
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import at_once_label, at_once_lines, program_lines
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_until_ns
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile

SAME = {"x": trapezoid(20_000, 0, 80_000, 700_000)}
SLOWER = {"x": trapezoid(20_000, 0, 50_000, 400_000)}
OTHER_AXIS = {"y": trapezoid(0, 20_000, 80_000, 700_000)}


async def load_at_once(pair: Pair, profiles: dict[str, Profile]) -> None:
    """Lower and load the second move for its earliest instant."""
    start = StartOptions(lead_ns=NS_PER_S, exact=True, follows=True, at_once=True)
    pair.lowered = pair.driver.lower_profiles(profiles, start, pair.mapping)
    assert pair.lowered.gap_ns is not None and pair.lowered.release_ns == 0 and pair.lowered.can_advance
    pair.t0_ns = pair.ends_ns + pair.lowered.gap_ns
    await pair.load()


@pytest.mark.parametrize(
    ("profiles", "most_ms"), [(SAME, 4.9), (SLOWER, 6.9), (OTHER_AXIS, 6.9)], ids=["same", "slower", "other-axis"]
)
def test_a_move_begins_as_soon_as_the_one_before_has_ended(profiles: dict[str, Profile], most_ms: float) -> None:
    async def body(pair: Pair) -> None:
        await load_at_once(pair, profiles)
        await pair.driver.slots.following.release()
        first, started, second = await pair.follow_both()
        before, after = pair.motions()
        assert NS_PER_MS < after.start_ns - before.end_ns < most_ms * NS_PER_MS
        assert pair.lowered is not None
        earliest_ns, latest_ns = pair.lowered.window_ns
        assert earliest_ns <= after.start_ns - pair.t0_ns <= latest_ns
        (axis,) = profiles
        for interval, at_ns in (
            (first.ended["x"], before.end_ns),
            (started[axis], after.start_ns),
            (second.ended[axis], after.end_ns),
        ):
            assert isinstance(interval, HostInterval) and interval.earliest_ns <= at_ns <= interval.latest_ns

    run_pair(body, at_once=True)


def test_a_release_behind_the_end_begins_the_move_then() -> None:
    async def body(pair: Pair) -> None:
        await load_at_once(pair, SAME)
        assert await pair.follow_first() == "done"
        released_ns = pair.ends_ns + 100 * NS_PER_MS
        await sleep_until_ns(pair.world.clock, released_ns)
        assert len(pair.motions()) == 1
        await pair.driver.slots.following.release()
        await sleep_until_ns(pair.world.clock, released_ns + NS_PER_S)
        _, after = pair.motions()
        assert 0 < after.start_ns - released_ns < 15 * NS_PER_MS
        pair.driver.slots.advance()
        started = (await pair.driver.slots.present.wait_for_start())["x"]
        assert started.earliest_ns <= after.start_ns <= started.latest_ns
        # T0 was the end of the move before: the start is later than the controller guarantees from there.
        assert started.late_ns >= released_ns - pair.t0_ns - AT_ONCE_LATEST_NS > 0

    run_pair(body)


@pytest.mark.parametrize("how", ["limit", "stopped", "unloaded"])
def test_a_move_does_not_begin_unless_the_one_before_has_ended_as_planned(how: str) -> None:
    async def body(pair: Pair) -> None:
        await load_at_once(pair, SAME)
        await pair.driver.slots.following.release()
        await sleep_until_ns(pair.world.clock, pair.ends_ns - 200 * NS_PER_MS)
        if how == "limit":
            cast(Any, pair.world.controller).set_limit("X", "forward")
        elif how == "stopped":
            await pair.driver.stop(abort=False)
        else:
            await pair.driver.slots.following.unload()
        await sleep_until_ns(pair.world.clock, pair.t0_ns + NS_PER_S)
        assert len(pair.motions()) == 1

    run_pair(body)


def test_speeds_and_ramps_that_are_loaded_are_not_loaded_again() -> None:
    async def body(pair: Pair) -> None:
        await load_at_once(pair, SAME)
        lowered = pair.lowered
        assert isinstance(lowered, YaskawaLowered) and lowered.at_once
        speed_variable = await pair.driver.send_raw("MG XS1{F10.0}")
        assert float(speed_variable) == 0  # the variables of the registers are those of no step

    run_pair(body, at_once=True)


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize(("mask", "axes"), [(1, 1), (3, 2), (5, 4), (15, 4)])
def test_the_check_is_the_last_thing_before_the_begin(mask: int, axes: int, quick: bool) -> None:
    lines = at_once_lines(mask, axes, quick=quick)
    assert all(line in program_lines(axes, GateTiming.for_options(YaskawaOptions())) for line in lines)
    (begin,) = (line for line in lines if "BG" in line)
    check, _, motion = begin.partition("=0;BG")
    assert "XFGO&XDONE" in check and motion.endswith(";XFA=TIME")
    everything = next(line for line in lines if line.startswith("AM"))
    assert everything.split(";")[0] == "AM" + "XYZW"[:axes]  # all axes of the controller rest
    text = ";".join(lines)
    assert ("SP " in text) is not quick and "PA " in text
    assert lines[0].startswith(at_once_label(mask, quick=quick))
