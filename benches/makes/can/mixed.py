"""CiA 402 drives and SMC-4000 in one jerk-limited step: the drives of one CAN bus start by its SYNC, the others by
their clocks. By a complete coordinator in runs time, checked against the simulators' ground truth.
"""

from math import ceil
from random import Random
from typing import Any

from benches.makes.can.fleet import MEASURED_OPTIONS, make_can_row
from benches.makes.figures import BenchFigure
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import StepReport
from orchestrator.runtime.simulated_fleets import DRIFT_PPM, WANDER_PPM, make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet

CONTROLLERS_PER_MAKE = 4
TICK_MS = 1000 / 1024  # of an SMC-4000
TARGET_SKEW_MS = TICK_MS + 0.3
HISTORY_S = 120  # of reading the clocks
STEPS_PER_FLEET = 25
PAUSE_NS = 3 * NS_PER_S
_LIMITS = {"velocity": 200.0, "acceleration": 1000.0, "jerk": 20_000.0}


def bench_mixed(rounds: int, seed: int = 11) -> list[BenchFigure]:
    """Measure `rounds` steps, with new crystals every `STEPS_PER_FLEET` of them."""
    skews_ms: list[float] = []
    misses = 0
    for number in range(ceil(rounds / STEPS_PER_FLEET)):
        steps = min(STEPS_PER_FLEET, rounds - number * STEPS_PER_FLEET)
        runs = run_virtual(lambda clock, s=seed + number, n=steps: _run_fleet(clock, s, n))
        skews_ms += [skew_ms for skew_ms, _ in runs]
        misses += sum(not is_held for _, is_held in runs)
    title = f"start skew, {CONTROLLERS_PER_MAKE} by SYNC and {CONTROLLERS_PER_MAKE} SMC-4000 by clock"
    miss_figure = BenchFigure(
        what="of these starts outside their verdict",
        n=rounds,
        p50=0,
        p99=0,
        max=misses,
        unit="steps",
        asked="none",
        met=misses == 0,
    )
    return [make_can_row(title, skews_ms, "ms", round(TARGET_SKEW_MS, 3)), miss_figure]


def make_mixed_fleet(seed: int) -> Fleet:
    """Return a fleet with `CONTROLLERS_PER_MAKE` of both; the drives share one bus."""
    draw = Random(seed)

    def draw_crystal() -> dict[str, float]:
        return {
            "offset_s": draw.uniform(0, 600),
            "drift_ppm": draw.uniform(-DRIFT_PPM, DRIFT_PPM),
            "wander_ppm": WANDER_PPM,
        }

    controllers: dict[str, Any] = {}
    for number in range(CONTROLLERS_PER_MAKE):
        config = make_smc4000(number)
        controllers[f"a{number}"] = {**config, "simulate": {**config["simulate"], **draw_crystal()}}
        controllers[f"c{number}"] = {
            **_make_drive(number),
            "simulate": {"decode_us": 300, "spread_us": 400, **draw_crystal()},
        }
    for config in controllers.values():
        config["axes"] = {"x": {**config["axes"]["x"], "limits": _LIMITS}}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "mixed", "controllers": controllers})


def _make_drive(number: int) -> dict[str, Any]:
    axis = {"motors": ["1"], "unit": "mm", "scale": 1000}
    link = {"kind": "can", "interface": "socketcan", "channel": "can0", "bitrate": 1_000_000, "address": number + 1}
    return {"adapter": "cia402", "link": link, "options": MEASURED_OPTIONS, "axes": {"x": axis}}


async def _run_fleet(clock: VirtualClock, seed: int, steps: int) -> list[tuple[float, bool]]:
    """Return the true start skew of each step, ms, and whether its verdict contains it."""
    draw = Random(seed)
    fleet = VirtualFleet(make_mixed_fleet(seed), clock, seed, guardian=False)
    await fleet.start()
    names = list(fleet.fleet.controllers)
    await _run_job(fleet, [{"do": "enable", "axes": names}, {"do": "home"}])
    await sleep_ns(clock, HISTORY_S * NS_PER_S)
    results: list[tuple[float, bool]] = []
    for number in range(steps):
        await sleep_ns(clock, draw.randrange(PAUSE_NS))
        motion_counts = {name: len(unit.commanded_motions) for name, unit in fleet.controllers.items()}
        to = dict.fromkeys((f"{name}.x" for name in names), 0.0 if number % 2 else 60.0)
        report = await _run_job(fleet, [{"do": "move", "to": to, "speed": 0.5}])
        starts = [unit.commanded_motions[motion_counts[name]].start_ns for name, unit in fleet.controllers.items()]
        skew_ns, promise = max(starts) - min(starts), report.start_skew
        results.append((skew_ns * 1e-6, promise is not None and promise.at_least_ns <= skew_ns <= promise.at_most_ns))
    return results


async def _run_job(fleet: VirtualFleet, steps: list[dict[str, Any]]) -> StepReport:
    """Return the last step when all are done."""
    job = {"schema": "tutti.job/1", "name": "mixed", "max_start_skew": "50 ms", "max_end_skew": "50 ms", "steps": steps}
    client = fleet.make_client("mixed")
    try:
        report = await client.wait_for_job(await client.submit(Job.model_validate(job)))
    finally:
        await client.close()
    if report.state != "done":
        raise RuntimeError(f"a step of the benchmark did not run: {report.reason}")
    return report.steps[-1]
