"""Eight CiA 402 drives on one CAN bus at 1 Mbit/s: the spread of their starts, by the simulator's ground truth, and
the duration of arming compared with the frames that it needs, in virtual time.

Two start methods: a script writes the controlword to one drive after another by SDO, each as soon as the previous
one has replied; the adapter loads set-points that wait in the drives for one SYNC.
"""

import asyncio
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
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.can import CanLink
from orchestrator.model.messages import StartOptions
from orchestrator.plan.step import AxisMove, plan_step

COUNTS = 20_000
ASKED_SKEW_MS, ASKED_ARM = 0.15, 1.2
STARTS = 20  # of the same drives; from one start to the next the ticks of their control loops drift apart
IDLE_NS = 1000 * NS_PER_MS


class _CanRound(NamedTuple):
    """One start.

    off_ms: largest distance of a motion's start from T0.
    moving, load: share of the time that the bus was busy while all moved, and at rest."""

    skew_ms: float
    off_ms: float
    arm_ms: float
    frames_ms: float
    moving: float
    load: float


def bench_can(rounds: int, seed: int = 11) -> list[BenchFigure]:
    """Measure `rounds` starts with each method, with new drives and a new bus every `STARTS` of them."""
    by_script: list[float] = []
    results: list[_CanRound] = []
    for number in range(ceil(rounds / STARTS)):
        starts = min(STARTS, rounds - number * STARTS)
        by_script += run_virtual(lambda clock, s=seed + number, n=starts: _run_script(clock, s, n))
        results += run_virtual(lambda clock, s=seed + number, n=starts: _run_driver_steps(clock, s, n))
    return [
        make_can_row("start skew, 6040h by SDO one after another", by_script, "ms"),
        make_can_row("start skew, one SYNC", [result.skew_ms for result in results], "ms", ASKED_SKEW_MS),
        make_can_row("distance of the furthest start from T0", [result.off_ms for result in results], "ms"),
        make_can_row("arming all", [result.arm_ms for result in results], "ms"),
        make_can_row("frames of arming on the bus", [result.frames_ms for result in results], "ms"),
        make_can_row(
            "arming compared with its frames",
            [result.arm_ms / result.frames_ms for result in results],
            "times",
            ASKED_ARM,
        ),
        make_can_row("bus load by states, all moving", [100 * result.moving for result in results], "%"),
        make_can_row("bus load by states, at rest", [100 * result.load for result in results], "%"),
    ]


async def _run_driver_steps(clock: VirtualClock, seed: int, starts: int) -> list[_CanRound]:
    """Run steps of all eight through their drivers, like a coordinator, to and fro. One more is run first, because
    it switches the drives into their mode."""
    world = make_can_bench(clock, seed)
    await world.wait_until_ready()
    busy_ns = world.segment.bus.busy_ns
    await sleep_ns(clock, IDLE_NS)
    load = (world.segment.bus.busy_ns - busy_ns) / IDLE_NS
    steps = [await _run_step(world, *((COUNTS, 0) if number % 2 else (0, COUNTS))) for number in range(starts + 1)]
    await world.close_drivers()
    return [step._replace(load=load) for step in steps[1:]]


async def _run_step(world: CanBusBench, begin: int, end: int) -> _CanRound:
    profiles = dict(plan_step([AxisMove("a", begin, end, VELOCITY / 2, ACCELERATION / 2)]).profiles)
    clock, drivers = world.clock, world.drivers
    lowered_profiles = [driver.lower_profiles(profiles, StartOptions(), None) for driver in drivers]
    lead_ns = max(lowering.costs.arm_ns + lowering.costs.disarm_ns for lowering in lowered_profiles)
    t0_ns = clock.now_ns() + lead_ns + 100 * NS_PER_MS + world.draw.randrange(10 * NS_PER_MS)
    began_ns, ordered_ns = clock.now_ns(), world.command_ns
    await load_moves(drivers, lowered_profiles, t0_ns)
    arm_ms, frames_ms = (clock.now_ns() - began_ns) * 1e-6, (world.command_ns - ordered_ns) * 1e-6
    await release_moves(drivers)
    spans = await asyncio.gather(*(driver.slots.present.wait_for_start() for driver in drivers))
    busy_ns, moving_ns = world.segment.bus.busy_ns, clock.now_ns()
    outcomes = await asyncio.gather(*(driver.slots.present.wait_for_end() for driver in drivers))
    load_in_motion = (world.segment.bus.busy_ns - busy_ns) / (clock.now_ns() - moving_ns)
    starts = world.find_starts()
    for span, began, outcome in zip(spans, starts, outcomes, strict=True):
        if outcome.state != "done" or not span["a"].earliest_ns <= began <= span["a"].latest_ns:
            raise RuntimeError(f"a start of the benchmark differs from its driver's report: {outcome.reason or span}")
    off_ms = max(abs(start - t0_ns) for start in starts) * 1e-6
    return _CanRound(
        skew_ms=(max(starts) - min(starts)) * 1e-6,
        off_ms=off_ms,
        arm_ms=arm_ms,
        frames_ms=frames_ms,
        moving=load_in_motion,
        load=0.0,
    )


async def _run_script(clock: VirtualClock, seed: int, count: int) -> list[float]:
    """Return the skews when each drive gets its controlword by SDO, as soon as the previous one has replied."""
    world = make_can_bench(clock, seed)
    await world.wait_until_ready()
    can = CanLink(await world.wire.open_link(), BITRATE)
    skews: list[float] = []
    for number in range(count):
        target = 0 if number % 2 else COUNTS
        for node in NODES:
            for index, value, size in ((0x6060, 1, 1), (0x6040, 0x0F, 2), (0x607A, target, 4), (0x6081, 40_000, 4)):
                await write_object(can, node, (index, 0), value, size)
        await sleep_ns(clock, 100 * NS_PER_MS)
        for node in NODES:
            await write_object(can, node, (0x6040, 0), 0x1F, 2)
        await sleep_ns(clock, 1500 * NS_PER_MS)
        starts = world.find_starts()
        skews.append((max(starts) - min(starts)) * 1e-6)
    await can.close()
    await world.close_drivers()
    return skews
