"""Axes with errors by the position of another one, straightness and squareness: where they truly are, with and without
their tables."""

import asyncio
from typing import Any

import numpy as np
import pytest
from cluster.worlds import EXAMPLES, job, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.mechanics import Mechanics

PREPARE = "{do: enable, axes: [stage]}, {do: home, axes: [stage]}, {do: move, to: {stage.x: 100, stage.y: 75}}"
COUNT_MM = 1e-3


def stage_fleet(**group: Any) -> Fleet:
    """The example, with other fields of its group."""
    plain = load_fleet(EXAMPLES / "stage.fleet.yaml").to_plain()
    plain["virtual"]["stage"] |= group
    return Fleet.model_validate(plain)


def read_truth(fleet: VirtualFleet) -> tuple[float, float]:
    """Where the point of the stage truly is, mm."""
    mechanics = Mechanics(fleet.controllers["bench"], fleet.fleet.controllers["bench"])
    return mechanics.position("x"), mechanics.position("y")


@pytest.mark.parametrize("moves", [16, pytest.param(1000, marks=pytest.mark.nightly)])
def test_a_point_is_at_its_targets_by_truth(moves: int) -> None:
    """Straightness of ±16 µm and 0.05 mrad of squareness, at 1 µm a count."""

    async def main(fleet: VirtualFleet) -> list[float]:
        draw = np.random.default_rng(1)
        errors: list[float] = []
        group = "stage" if fleet.fleet.virtual else "bench"
        await outcome(fleet, job(f"[{PREPARE.replace('stage', group)}]"))
        for _ in range(moves):
            x, y = (round(float(value), 4) for value in draw.uniform((1, 1), (199, 149)))
            report = await outcome(fleet, job(f"[{{do: move, to: {{{group}.x: {x}, {group}.y: {y}}}}}]"))
            assert report.state == "done", report.reason
            true_x, true_y = read_truth(fleet)
            bounds = report.steps[0].bounds
            if bounds:
                assert abs(true_x - x) <= bounds["stage.x"].most and abs(true_y - y) <= bounds["stage.y"].most
            errors.append(max(abs(true_x - x), abs(true_y - y)))
        return errors

    errors = run_fleet(main, stage_fleet())
    print("with", np.percentile(errors, 99), max(errors))
    assert np.percentile(errors, 99) <= 2 * COUNT_MM
    bare_fleet = Fleet.model_validate({**stage_fleet().to_plain(), "virtual": {}})
    bare = run_fleet(main, bare_fleet)
    print("without", np.percentile(bare, 99), max(bare))


@pytest.mark.parametrize("frame", ["", "frame: stage, "])
def test_path(frame: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        start = "stage.x: 20, stage.y: 50" if frame else "bench.x: 20, bench.y: 50"
        print(await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{{start}}}}}]")))
        seen = []

        async def watch() -> None:
            while True:
                seen.append(read_truth(fleet))
                await sleep_ns(fleet.clock, NS_PER_MS)

        watching = asyncio.get_running_loop().create_task(watch())
        line = "{piece: line, to: [180, 50]}"
        path = f"{{do: path, axes: [bench.x, bench.y], {frame}start: [20, 50], speed: 20 mm/s, tolerance: 10 um, pieces: [{line}]}}"
        report = await outcome(fleet, job(f"[{path}]"))
        watching.cancel()
        assert report.state == "done", report.reason
        path_report = report.steps[0].path
        print(path_report.bound)
        off = max(abs(y - 50) for _, y in seen)
        print("OFF", frame, off, path_report.bound.predicted)

    run_fleet(main, stage_fleet())


def test_move_way():
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE}]"))
        seen = []
        async def watch() -> None:
            while True:
                seen.append(read_truth(fleet))
                await sleep_ns(fleet.clock, NS_PER_MS)
        await outcome(fleet, job("[{do: move, to: {stage.x: 20, stage.y: 50}}]"))
        watching = asyncio.get_running_loop().create_task(watch())
        report = await outcome(fleet, job("[{do: move, to: {stage.x: 180}}]"))
        watching.cancel()
        print("MOVE", report.state, report.reason, report.steps[0].virtual)
        print("OFF move", max(abs(y - 50) for _, y in seen))
    run_fleet(main, stage_fleet())
