"""Eight CiA 402 drives that follow streamed positions on one CAN bus at 1 Mbit/s, jerk-limited, in virtual time:
their deviation from each other and from the plan by the simulator's ground truth, the bus load, and late
positions.

For comparison, the same plans by a script that sends positions and a SYNC by a timer of its event loop.
"""

import asyncio
from collections.abc import Mapping
from math import ceil
from typing import NamedTuple

from benches.makes.can.fleet import (
    ACCELERATION,
    BITRATE,
    NODES,
    VELOCITY,
    CanBusBench,
    make_can_bench,
    make_can_row,
    write_object,
)
from benches.makes.drivers import load_moves, release_moves
from benches.makes.figures import BenchFigure
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns, sleep_until_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.can import CanFrame, CanLink
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step

JERK = 4_000_000.0
PERIOD_NS = 10 * NS_PER_MS
SCRIPT_LATE_NS = 100 * NS_PER_US, 3 * NS_PER_MS  # largest delay of a loop's timer under other load
NEAR, FAR = 20_000, 40_000  # distances of the axes, counts
CRUISE = 20_000.0
LONG_DISTANCE = 400_000  # 20 s at that speed
PEAK_SHARE = 0.1  # of the peak velocity; below it a distance is not converted to a time
SAMPLE_NS = NS_PER_MS
MOVES_PER_BUS = 20  # of the same drives
SLOW_SIMULATION = {"event_ms": 10}
"""Of the simulated drives over hours: their states are not sent more often in any case."""
ASKED_SKEW_MS, ASKED_LOAD = 0.3, 60.0
_CYCLIC = 8
_REST = 4  # periods


class _StreamRound(NamedTuple):
    """One move.

    skew_ms: largest distance in time between axes on their plans.
    off_ms: largest distance of one axis from its own plan.
    load: share of the time that the bus was busy."""

    skew_ms: float
    off_ms: float
    load: float


def bench_stream(rounds: int, hours: float, seed: int = 11) -> list[BenchFigure]:
    """Measure `rounds` moves with each method, with new drives every `MOVES_PER_BUS` of them; and long moves for
    `hours`."""
    by_script: list[_StreamRound] = []
    results: list[_StreamRound] = []
    for number in range(ceil(rounds / MOVES_PER_BUS)):
        moves = min(MOVES_PER_BUS, rounds - number * MOVES_PER_BUS)
        by_script += run_virtual(lambda clock, s=seed + number, n=moves: _run_scripts(clock, s, n))
        results += run_virtual(lambda clock, s=seed + number, n=moves: _run_streams(clock, s, n))
    periods, underruns = run_virtual(lambda clock: _stream_for_hours(clock, seed, hours))
    empty_figure = BenchFigure(
        what=f"underruns in {hours:g} h of streams",
        n=periods,
        p50=0,
        p99=0,
        max=underruns,
        unit="moves",
        asked="none",
        met=underruns == 0,
    )
    return [
        make_can_row("path skew, positions by a script's timer", [script.skew_ms for script in by_script], "ms"),
        make_can_row("path skew, streamed", [stream.skew_ms for stream in results], "ms", ASKED_SKEW_MS),
        make_can_row("furthest from the plan, by a script's timer", [script.off_ms for script in by_script], "ms"),
        make_can_row("furthest from the plan, streamed", [stream.off_ms for stream in results], "ms"),
        make_can_row(
            "bus load, all eight follow at 100 Hz", [100 * stream.load for stream in results], "%", ASKED_LOAD
        ),
        empty_figure,
    ]


async def _run_streams(clock: VirtualClock, seed: int, moves: int) -> list[_StreamRound]:
    world = make_can_bench(clock, seed, {"jerk": JERK})
    await world.wait_until_ready()
    streams: list[_StreamRound] = []
    for _ in range(moves):
        profiles = _make_plan(world)
        t0_ns = await _start_moves(world, profiles)
        await sleep_until_ns(clock, t0_ns)
        watching = asyncio.get_running_loop().create_task(_measure_deviation(world, profiles, t0_ns))
        busy_ns = world.segment.bus.busy_ns
        if not await _wait_for_ends(world):
            raise RuntimeError("a move of the benchmark did not complete")
        load = (world.segment.bus.busy_ns - busy_ns) / (clock.now_ns() - t0_ns)
        streams.append(_StreamRound(*await watching, load))
    await world.close_drivers()
    return streams


async def _run_scripts(clock: VirtualClock, seed: int, moves: int) -> list[_StreamRound]:
    """Move the drives by a script, after their drivers have enabled them."""
    world = make_can_bench(clock, seed, {"jerk": JERK})
    await world.wait_until_ready()
    can = CanLink(await world.wire.open_link(), BITRATE)
    for node in NODES:
        await write_object(can, node, (0x6060, 0), _CYCLIC, 1)
    await sleep_ns(clock, 100 * NS_PER_MS)
    scripts: list[_StreamRound] = []
    for _ in range(moves):
        profiles = _make_plan(world)
        ats = {node: profile.make_evaluator() for node, profile in profiles.items()}
        t0_ns, busy_ns = clock.now_ns(), world.segment.bus.busy_ns
        watching = asyncio.get_running_loop().create_task(_measure_deviation(world, profiles, t0_ns))
        periods = 1
        # Until all are at rest: moving drives report a fault without SYNC.
        while periods * PERIOD_NS <= profiles[1].duration_s * NS_PER_S + _REST * PERIOD_NS:
            for node, at in ats.items():
                counts = profiles[node].start_counts + round(at(periods * PERIOD_NS / NS_PER_S).position)
                can.send_frames(CanFrame(0x500 + node, counts.to_bytes(4, "little", signed=True)))
            can.send_frames(CanFrame(0x080))
            await sleep_until_ns(clock, t0_ns + periods * PERIOD_NS + world.draw.randint(*SCRIPT_LATE_NS))
            periods += 1
        load = (world.segment.bus.busy_ns - busy_ns) / (clock.now_ns() - t0_ns)
        scripts.append(_StreamRound(*await watching, load))
    await can.close()
    await world.close_drivers()
    return scripts


async def _stream_for_hours(clock: VirtualClock, seed: int, hours: float) -> tuple[int, int]:
    """Return the number of stream periods, and of moves that did not end as planned."""
    world = make_can_bench(clock, seed, {"jerk": JERK}, SLOW_SIMULATION)
    await world.wait_until_ready()
    until_ns = clock.now_ns() + round(hours * 3600 * NS_PER_S)
    begin = periods = 0
    while clock.now_ns() < until_ns:
        end = 0 if begin else LONG_DISTANCE
        move = AxisMove(
            axis="a",
            start_counts=begin,
            target_counts=end,
            velocity=CRUISE,
            acceleration=ACCELERATION / 2,
            jerk=JERK,
            order=3,
        )
        profile = plan_step([move]).profiles["a"]
        await _start_moves(world, dict.fromkeys(NODES, profile))
        if not await _wait_for_ends(world):
            return periods, 1
        periods += round(profile.duration_s * NS_PER_S / PERIOD_NS)
        begin = end
    await world.close_drivers()
    return periods, 0


def _make_plan(world: CanBusBench) -> dict[int, Profile]:
    """Plan one duration, and a distance for each axis, by node; away from 0, or back."""
    starts = {node: round(unit.position("1")) for node, unit in zip(NODES, world.drives, strict=True)}
    targets = {node: 0 if starts[node] else world.draw.randint(NEAR, FAR) for node in NODES}
    moves = [
        AxisMove(
            axis=f"{node}",
            start_counts=starts[node],
            target_counts=targets[node],
            velocity=VELOCITY / 2,
            acceleration=ACCELERATION / 2,
            jerk=JERK,
            order=3,
        )
        for node in NODES
    ]
    return {int(node): profile for node, profile in plan_step(moves).profiles.items()}


async def _start_moves(world: CanBusBench, profiles: Mapping[int, Profile]) -> int:
    """Arm and release the moves; return T0."""
    lowered_profiles = [
        driver.lower_profiles({"a": profiles[node]}, StartOptions(), None)
        for node, driver in zip(NODES, world.drivers, strict=True)
    ]
    lead_ns = max(lowering.costs.arm_ns + lowering.costs.disarm_ns for lowering in lowered_profiles)
    t0_ns = world.clock.now_ns() + lead_ns + world.draw.randrange(10 * NS_PER_MS)
    await load_moves(world.drivers, lowered_profiles, t0_ns)
    await release_moves(world.drivers)
    return t0_ns


async def _wait_for_ends(world: CanBusBench) -> bool:
    """Wait for the ends; return whether all drivers report a start and a completed move."""
    await asyncio.gather(*(driver.slots.present.wait_for_start() for driver in world.drivers))
    outcomes = await asyncio.gather(*(driver.slots.present.wait_for_end() for driver in world.drivers))
    return all(outcome.state == "done" for outcome in outcomes)


async def _measure_deviation(world: CanBusBench, profiles: Mapping[int, Profile], t0_ns: int) -> tuple[float, float]:
    """Return the largest distance in time between axes on their plans, and of one axis from its own, ms: (position -
    plan) / planned velocity, where that is at least a tenth of the axis's peak. Sampled about every millisecond."""
    at = {
        node: (profile.make_evaluator(), profile.peak_velocity, profile.start_counts)
        for node, profile in profiles.items()
    }
    duration_s = max(profile.duration_s for profile in profiles.values())
    skew_s = off_s = since_s = 0.0
    while since_s < duration_s:
        late: list[float] = []
        for (evaluate, peak, start), unit in zip(at.values(), world.drives, strict=True):
            instant = evaluate(since_s)
            if abs(instant.velocity) >= PEAK_SHARE * peak:
                late.append((unit.position("1") - start - instant.position) / instant.velocity)
        if late:
            skew_s, off_s = max(skew_s, max(late) - min(late)), max(off_s, max(map(abs, late)))
        await sleep_ns(world.clock, SAMPLE_NS // 2 + world.draw.randrange(SAMPLE_NS))
        since_s = (world.clock.now_ns() - t0_ns) / NS_PER_S
    return skew_s * 1e3, off_s * 1e3
