"""Draw `docs/figures/flown-raster.png`: lines of a scan that are flown in one motion by an SMC-4000 and a CiA 402
drive, as their simulators truly move, with a pulse in each window, in virtual time."""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

import asyncio
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import PointRecord
from orchestrator.model.steps.scan import Scan
from orchestrator.plan.flying.flight import Flight, plan_flight
from orchestrator.plan.flying.line_plan import plan_lines
from orchestrator.runtime.virtual.fleet import VirtualFleet

ROOT = Path(__file__).parents[1]
SEED = 55
LOOK_NS = NS_PER_MS
LINES, POINTS, WINDOW_S, SPACING = 5, 21, 0.02, 0.5
OUTER, FLOWN = "slide.y", "gantry.x"
BLUE, ORANGE, GREY, RED = "#1d4ed8", "#ea580c", "#9ca3af", "#dc2626"

Array = NDArray[np.float64]


class Truth(NamedTuple):
    """What was seen: instants of host time, s, positions of both axes, those at which the output became active, and the
    rows of the points."""

    times_s: Array
    positions: Array
    pulses_s: Array
    places: Array
    rows: list[PointRecord]
    origin_s: float


def _make_fleet() -> Fleet:
    plain = load_fleet(ROOT / "deploy" / "examples" / "path.fleet.yaml").to_plain()
    plain["controllers"]["gantry"]["outputs"] = {"camera": {"number": 1}}
    return Fleet.model_validate(plain)


def _make_scan() -> dict[str, Any]:
    fly = {"duration": f"{WINDOW_S * 1e3:g} ms", "trigger": {"output": "gantry.camera", "at": "middle"}}
    outer = {"from": 50, "to": 50 + LINES - 1, "points": LINES}
    flown = {"from": 20, "to": 20 + SPACING * (POINTS - 1), "points": POINTS, "snake": True}
    return {"do": "scan", "axes": {OUTER: outer, FLOWN: flown}, "fly": fly}


def _fly(fleet_file: Fleet) -> Truth:
    """Run the scan in virtual time."""

    async def run_scan(clock: VirtualClock) -> Truth:
        fleet = VirtualFleet(fleet_file, clock, SEED, guardian=False)
        await fleet.start()
        client = fleet.make_client("picture")
        steps = [{"do": "enable", "axes": list(fleet_file.controllers)}, {"do": "home"}]
        for part in (steps, [_make_scan()]):
            job = Job.model_validate({"schema": "tutti.job/1", "name": "picture", "steps": part})
            if part is steps:
                await client.wait_for_job(await client.submit(job))
        motors = [(axis, fleet.controllers[axis.partition(".")[0]]) for axis in (OUTER, FLOWN)]
        rows: list[tuple[float, float, float]] = []
        pulses: list[tuple[float, float, float]] = []

        def read() -> tuple[float, float, float]:
            outer, flown = (
                fleet_file.axis(axis).to_unit(unit.position(fleet_file.axis(axis).motors[0])) for axis, unit in motors
            )
            return clock.now_ns() / NS_PER_S, outer, flown

        fleet.controllers["gantry"].on_output(lambda _, level: pulses.append(read()) if level else None)

        async def look() -> None:
            while True:
                await sleep_ns(clock, LOOK_NS)
                rows.append(read())

        looking = asyncio.get_running_loop().create_task(look())
        report = await client.wait_for_job(await client.submit(job))
        looking.cancel()
        assert report.state == "done" and report.verdict == "green", report.reason
        seen, switched = np.array(rows), np.array(pulses)
        records = await client.load_points(report.job_id)
        first = records[0].window
        assert first is not None
        # The middle of the first window is where its pulse was.
        origin_s = float(switched[0, 0]) - (first.middle.earliest_ns + first.middle.latest_ns) / 2 / NS_PER_S
        return Truth(seen[:, 0], seen[:, 1:], switched[:, 0], switched[:, 1:], records, origin_s)

    return run_virtual(run_scan)


def _draw_course(axes: Axes, flight: Flight, truth: Truth) -> None:
    times_s = np.linspace(0.0, flight.duration_s, 4000)
    plan = flight.motion.evaluate(times_s)[0]
    inside = np.zeros(len(times_s), dtype=bool)
    for line in flight.lines:
        inside |= (times_s >= line.begin_s) & (times_s <= line.end_s)
    axes.plot(plan[:, 1], np.where(inside, plan[:, 0], np.nan), color=BLUE, linewidth=2.4, label="plan: windows")
    axes.plot(plan[:, 1], np.where(inside, np.nan, plan[:, 0]), color=ORANGE, linewidth=2.4, label="plan: turn-arounds")
    axes.plot(truth.positions[:, 1], truth.positions[:, 0], color="black", linewidth=0.8, label="true way")
    axes.plot(truth.places[:, 1], truth.places[:, 0], ".", color=RED, markersize=5, label="true pulses")
    axes.set_xlim(16.5, 33.5)
    axes.set_ylim(49.4, 50 + LINES - 0.2)
    axes.set_xlabel(f"{FLOWN}, mm (SMC-4000)")
    axes.set_ylabel(f"{OUTER}, mm (CiA 402)")
    axes.legend(loc="upper center", ncols=4, frameon=False)


def _draw_speed(axes: Axes, truth: Truth) -> None:
    began_s = truth.pulses_s[0] - 0.2
    middles_s = (truth.times_s[1:] + truth.times_s[:-1]) / 2 - began_s
    speeds = np.abs(np.diff(truth.positions[:, 1]) / np.diff(truth.times_s))
    smooth = np.convolve(speeds, np.ones(8) / 8, mode="same")
    for number, row in enumerate(truth.rows):
        assert row.window is not None
        lower, upper = (
            (edge.earliest_ns + edge.latest_ns) / 2 / NS_PER_S + truth.origin_s - began_s
            for edge in (row.window.lower, row.window.upper)
        )
        axes.axvspan(lower, upper, color=BLUE, alpha=0.10 if number % 2 else 0.18, linewidth=0)
    axes.plot(middles_s, smooth, color="black", linewidth=1.0)
    axes.plot(truth.pulses_s - began_s, np.full(len(truth.pulses_s), SPACING / WINDOW_S), ".", color=RED, markersize=4)
    axes.set_xlim(0.0, truth.pulses_s[-1] - began_s + 0.2)
    axes.set_ylim(0.0, 1.3 * SPACING / WINDOW_S)
    axes.set_xlabel("s; windows by their rows (blue), and pulses (red)")
    axes.set_ylabel(f"true speed of {FLOWN}, mm/s")


def main() -> None:
    """Write the picture."""
    fleet = _make_fleet()
    lines = plan_lines(Scan.model_validate(_make_scan()), fleet)
    flight, truth = plan_flight(lines, fleet, (0, LINES * POINTS)), _fly(fleet)
    mpl.rcParams["font.size"] = 9
    figure = Figure(figsize=(10.0, 6.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.add_subplot(2, 1, 1), figure.add_subplot(2, 1, 2)
    _draw_course(above, flight, truth)
    _draw_speed(below, truth)
    for axes in (above, below):
        axes.grid(alpha=0.3)
    figure.align_ylabels([above, below])
    figure.savefig(ROOT / "docs/figures/flown-raster.png")


if __name__ == "__main__":
    main()
