"""A move loaded behind the present one of an SMC-4000, against the simulated controller in virtual time."""

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from contextlib import suppress
from typing import Any, cast

import pytest
from unit.adapters.test_smc4000_bench import FLEET, World, run, trapezoid

from adapters.contract import HostInterval, Lowered, MoveOutcome
from adapters.yaskawa.common.gate import GateTiming
from adapters.yaskawa.common.options import YaskawaOptions
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step

FIRST = {"x": trapezoid(0, 20_000, 80_000, 700_000)}
BACK = {"x": trapezoid(20_000, 0, 80_000, 700_000)}
SMOOTH: dict[str, Any] = {"velocity": 100.0, "acceleration": 1000.0, "jerk": 10000.0}
SMOOTH_FLEET: dict[str, Any] = {
    **FLEET,
    "axes": {"x": {"motors": ["X"], "unit": "mm", "scale": 1000, "limits": SMOOTH}},
}


class Pair:
    """A move that is under way, and one to load behind it."""

    def __init__(self, world: World, mapping: TickMapping, ends_ns: int) -> None:
        self.world = world
        self.driver = world.driver
        self.mapping = mapping
        self.ends_ns = ends_ns
        self.lowered: Lowered | None = None
        self.t0_ns = 0

    def lower(self, profiles: dict[str, Profile], gap_ns: int | None = None) -> None:
        """Lower the second move for `gap_ns` after the end of the first one; by default as soon as it can."""
        lead_ns = self.ends_ns - self.mapping.host_at_ns + NS_PER_S // 50
        start = StartOptions(lead_ns=lead_ns, exact=True, follows=True)
        self.lowered = self.driver.lower_profiles(profiles, start, self.mapping)
        self.t0_ns = self.ends_ns + (gap_ns if gap_ns is not None else self.lowered.gap_ns or 0)

    async def load(self) -> None:
        assert self.lowered is not None
        await self.driver.slots.following.load(self.lowered, self.t0_ns, self.mapping, "beside")

    async def follow_first(self) -> str:
        """Follow the first move to its end."""
        return (await self.driver.slots.present.wait_for_end()).state

    async def follow_both(self) -> tuple[MoveOutcome, Mapping[str, HostInterval], MoveOutcome]:
        """Follow both moves, which are done; return the end of the first one, and start and end of the second."""
        first = await self.driver.slots.present.wait_for_end()
        self.driver.slots.advance()
        started = await self.driver.slots.present.wait_for_start()
        second = await self.driver.slots.present.wait_for_end()
        assert (first.state, second.state) == ("done", "done")
        return first, started, second

    def motions(self) -> list[Any]:
        return list(self.world.controller.commanded_motions)


def run_pair(
    body: Callable[[Pair], Coroutine[Any, Any, None]],
    first: dict[str, Profile] | None = None,
    fleet: dict[str, Any] | None = None,
    axes: tuple[str, ...] = ("x", "y"),
    at_once: bool = False,
) -> None:
    async def main(world: World) -> None:
        driver = world.driver
        await driver.connect()
        await driver.configure()
        await driver.set_enabled(list(axes), on=True)
        for _ in range(30):
            await driver.poll()
            await sleep_ns(world.clock, 100 * NS_PER_MS)
        mapping = driver.clock_mapping()
        assert mapping is not None
        t0_ns = world.clock.now_ns() + NS_PER_S // 2
        lowered = driver.lower_profiles(
            FIRST if first is None else first,
            StartOptions(lead_ns=t0_ns - mapping.host_at_ns, exact=True, at_once=at_once),
            mapping,
        )
        await driver.slots.present.load(lowered, t0_ns, mapping)
        await driver.slots.present.verify()
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        await body(Pair(world, mapping, t0_ns + round(max(lowered.durations_s.values()) * NS_PER_S)))

    run(main, fleet=fleet)


def test_a_released_move_begins_in_its_window_and_both_have_their_stamps() -> None:
    async def body(pair: Pair) -> None:
        pair.lower(BACK)
        await pair.load()
        await pair.driver.slots.following.verify()
        await pair.driver.slots.following.release()
        first, started, second = await pair.follow_both()
        before, after = pair.motions()
        assert pair.lowered is not None
        earliest_ns, latest_ns = pair.lowered.window_ns
        assert earliest_ns <= after.start_ns - pair.t0_ns <= latest_ns
        for interval, at_ns in (
            (first.ended["x"], before.end_ns),
            (started["x"], after.start_ns),
            (second.ended["x"], after.end_ns),
        ):
            assert isinstance(interval, HostInterval) and interval.earliest_ns <= at_ns <= interval.latest_ns

    run_pair(body)


@pytest.mark.parametrize("release", [False, True])
@pytest.mark.parametrize("how", ["unloaded", "stopped", "not released"])
def test_a_move_that_is_withdrawn_does_not_begin(how: str, release: bool) -> None:
    async def body(pair: Pair) -> None:
        pair.lower(BACK)
        await pair.load()
        if release and how != "not released":
            await pair.driver.slots.following.release()
        if how == "unloaded":
            await pair.driver.slots.following.unload()
            await pair.driver.slots.following.unload()  # idempotent
        elif how == "stopped":
            await pair.driver.stop(abort=False)
        state = await pair.follow_first()
        await sleep_until_ns(pair.world.clock, pair.t0_ns + NS_PER_S)
        assert len(pair.motions()) == 1 and state == ("stopped" if how == "stopped" else "done")

    run_pair(body)


def test_a_move_does_not_begin_where_the_one_before_has_not_ended() -> None:
    """An axis met a limit switch before its last ramp; no adapter has to notice."""

    async def body(pair: Pair) -> None:
        pair.lower(BACK)
        await pair.load()
        await pair.driver.slots.following.release()
        await sleep_until_ns(pair.world.clock, pair.ends_ns - 200 * NS_PER_MS)
        cast(Any, pair.world.controller).set_limit("X", "forward")
        await sleep_until_ns(pair.world.clock, pair.t0_ns + NS_PER_S)
        assert len(pair.motions()) == 1

    run_pair(body)


def test_a_move_that_is_only_loaded_does_not_extend_the_watchdog_of_the_present_one() -> None:
    async def body(pair: Pair) -> None:
        clock = pair.world.clock
        pair.lower({"x": trapezoid(160_000, 0, 80_000, 700_000)}, gap_ns=5 * NS_PER_S)
        watching = asyncio.create_task(pair.driver.slots.present.wait_for_end())
        await pair.load()
        await sleep_ns(clock, NS_PER_S)
        watching.cancel()
        with suppress(asyncio.CancelledError):
            await watching
        silent_ns = clock.now_ns()
        await sleep_until_ns(clock, pair.t0_ns + NS_PER_S)
        (first,) = pair.motions()
        assert first.end_ns - silent_ns < YaskawaOptions().watchdog_s * NS_PER_S + NS_PER_S // 10
        assert first.end_counts < 160_000

    run_pair(body, {"x": trapezoid(0, 160_000, 20_000, 700_000)})


@pytest.mark.parametrize(("later_ns", "code"), [(0, ""), (-3 * NS_PER_MS, "late")])
def test_a_move_is_refused_that_begins_before_the_program_can(later_ns: int, code: str) -> None:
    gap_ticks = GateTiming.for_options(YaskawaOptions()).gap_ticks(1, 4, YaskawaOptions().tick_ns)
    least_ns = round((gap_ticks + 1) * YaskawaOptions().tick_ns)

    async def body(pair: Pair) -> None:
        pair.lower(BACK, gap_ns=least_ns + later_ns)
        if not code:
            await pair.load()
            return
        with pytest.raises(Refusal) as caught:
            await pair.load()
        assert caught.value.code == code
        assert await pair.follow_first() == "done" and len(pair.motions()) == 1

    run_pair(body)


@pytest.mark.parametrize("start", [19_999, 0])
def test_a_move_from_another_place_than_the_end_of_the_present_one_is_refused(start: int) -> None:
    async def body(pair: Pair) -> None:
        pair.lower({"x": trapezoid(start, start + 5000, 80_000, 700_000)}, gap_ns=NS_PER_S // 10)
        with pytest.raises(Refusal) as caught:
            await pair.load()
        assert caught.value.code == "other-start" and "axis x ends at 20000 counts" in caught.value.text
        assert await pair.follow_first() == "done"

    run_pair(body)


def test_a_move_of_an_axis_that_rests_begins_where_that_axis_is() -> None:
    async def body(pair: Pair) -> None:
        pair.lower({"y": trapezoid(1, 5000, 80_000, 700_000)}, gap_ns=NS_PER_S // 10)
        with pytest.raises(Refusal) as caught:
            await pair.load()
        assert caught.value.code == "other-start" and "axis y ends at 0 counts" in caught.value.text
        pair.lower({"y": trapezoid(0, 5000, 80_000, 700_000)}, gap_ns=NS_PER_S // 10)
        await pair.load()
        await pair.driver.slots.following.release()
        assert await pair.follow_first() == "done"
        await sleep_until_ns(pair.world.clock, pair.t0_ns + NS_PER_S)
        assert [each.axis for each in pair.motions()] == ["X", "Y"]

    run_pair(body)


def test_a_release_that_comes_too_late_is_refused_and_nothing_begins() -> None:
    async def body(pair: Pair) -> None:
        pair.lower(BACK)
        await pair.load()
        await sleep_until_ns(pair.world.clock, pair.t0_ns - 3 * NS_PER_MS)
        with pytest.raises(Refusal) as caught:
            await pair.driver.slots.following.release()
        assert caught.value.code == "late"
        await sleep_until_ns(pair.world.clock, pair.t0_ns + NS_PER_S)
        assert len(pair.motions()) == 1

    run_pair(body)


@pytest.mark.parametrize("call", ["verify", "release"])
def test_nothing_is_promised_or_released_that_is_not_loaded(call: str) -> None:
    async def body(pair: Pair) -> None:
        with pytest.raises(Refusal) as caught:
            await getattr(pair.driver.slots.following, call)()
        assert caught.value.code == "not-armed"

    run_pair(body)


def smooth(start: int, end: int) -> dict[str, Profile]:
    """A jerk-limited move, which is played as a contour."""
    return dict(plan_step([AxisMove("x", start, end, 80_000.0, 700_000.0, jerk=9_000_000.0, order=3)]).profiles)


def test_a_contour_has_no_place_beside_another_move() -> None:
    async def behind_contour(pair: Pair) -> None:
        pair.lower(BACK, gap_ns=NS_PER_S // 10)
        with pytest.raises(Refusal) as caught:
            await pair.load()
        assert caught.value.code == "no-room"

    async def contour_behind(pair: Pair) -> None:
        pair.lower(smooth(20_000, 0), gap_ns=NS_PER_S // 10)
        assert pair.lowered is not None and pair.lowered.gap_ns is None
        with pytest.raises(Refusal) as caught:
            await pair.load()
        assert caught.value.code == "no-room"

    run_pair(behind_contour, smooth(0, 20_000), SMOOTH_FLEET, ("x",))
    run_pair(contour_behind, None, SMOOTH_FLEET, ("x",))
