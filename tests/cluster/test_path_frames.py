"""Paths in frames of the fleet file: coordinates turned onto axes, judged by the simulators' truth."""

import json
from math import cos, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from cluster.test_contour import two_gantries
from cluster.test_paths import ALONE, circle_errors, follow, is_moving, prepare
from cluster.worlds import job, outcome, refusal, run_fleet
from pydantic import ValidationError

from orchestrator.cli.main import main
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.queue import QueueTerms
from orchestrator.monitor.path_words import describe_path
from orchestrator.runtime.virtual.fleet import VirtualFleet

TURN = 30.0
PLATE: dict[str, Any] = {
    "axes": ["gantry.x", "gantry.y"],
    "coordinates": ["u", "v"],
    "rotation": TURN,
    "offset": [100, 100],
}


def framed(**fields: Any) -> Fleet:
    plain = two_gantries().to_plain()
    return Fleet.model_validate(plain | {"frames": {"plate": PLATE | fields}})


def to_axes(u: float, v: float) -> tuple[float, float]:
    c, s = cos(radians(TURN)), sin(radians(TURN))
    return 100 + c * u - s * v, 100 + s * u + c * v


def square(axes: str = "gantry.x, gantry.y", **fields: str) -> Job:
    """A circle about the origin of the frame."""
    more = "".join(f", {name}: {value}" for name, value in fields.items())
    pieces = "[{piece: helix, to: [50, 0], centre: [0, 0], turns: 0}]"
    steps = (
        f"[{{do: path, axes: [{axes}], frame: plate, start: [50, 0], pieces: {pieces}, tolerance: 100 um,"
        f" speed: 100 mm/s{more}}}]"
    )
    return job(steps)


async def begin_at(fleet: VirtualFleet, u: float, v: float) -> None:
    x, y = to_axes(u, v)
    prepared = await outcome(
        fleet, prepare(fleet.fleet, ALONE), job(f"[{{do: move, to: {{gantry.x: {x}, gantry.y: {y}}}}}]")
    )
    assert prepared.state == "done", prepared.reason


def test_points_are_coordinates_and_axes_follow_them() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await begin_at(fleet, 50, 0)
        report, seen = await follow(fleet, ALONE, square())
        path = report.steps[0].path
        assert path is not None and path.bound is not None and path.frame == "plate"
        # The origin of the frame is where the axes are at 100, 100.
        assert circle_errors(np.array(seen)).max() < path.bound.predicted
        assert "in frame plate" in describe_path(path)[0]
        first = np.array(seen[len(seen) // 8])
        assert first[0] < 143.3 and first[1] > 125  # counter-clockwise from 30°

    run_fleet(main, framed())


def test_a_start_elsewhere_is_told_in_coordinates() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await begin_at(fleet, 40, 10)
        found = await refusal(fleet, square())
        assert found.code == "other-start" and "in plate the axes are at u 40, v 10 mm" in found.text, found.text

    run_fleet(main, framed())


def test_soft_limits_hold_for_the_axes() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await begin_at(fleet, 0, 0)
        await sleep_ns(fleet.clock, NS_PER_S)
        away = "[{piece: line, to: [0, -160]}]"  # only 160 mm in coordinates; the axes reach -38.6 mm
        found = await refusal(
            fleet,
            job(
                f"[{{do: path, axes: [gantry.x, gantry.y], frame: plate, start: [0, 0], pieces: {away}, tolerance: 1}}]"
            ),
        )
        assert found.code == "soft-limit" and "gantry.y reaches" in found.text
        assert not is_moving(fleet, ALONE)

    run_fleet(main, framed())


def test_a_path_with_other_axes_than_its_frame() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await begin_at(fleet, 50, 0)
        found = await refusal(fleet, square("gantry.y, gantry.x"))
        assert found.code == "other-axes" and "its frame gantry.x, gantry.y" in found.text

    run_fleet(main, framed())


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"axes": ["gantry.x", "gantry.q"]}, "the fleet has no axis gantry.q"),
        ({"unit": "um"}, "axis gantry.x is in mm, and the coordinates in um"),
        ({"offset": [100, "3 deg"]}, "frames.plate.offset.1"),
        ({"scale": [1.0, 0.0]}, "must have an inverse"),
    ],
)
def test_mistakes_of_a_frame_are_named(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError) as caught:
        framed(**fields)
    places = [".".join(map(str, each["loc"])) for each in caught.value.errors()]
    assert words in str(caught.value) or words in places


def test_a_changed_frame_changes_the_plan_that_is_approved() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await begin_at(fleet, 50, 0)
        client = fleet.make_client()
        job_id = await client.submit(square(), terms=QueueTerms(proposed=True))
        before = await client.plan_job(job_id)
        await client.reload_fleet(framed(rotation=31))
        after = await client.plan_job(job_id)
        assert before.plan is not None and after.plan is not None and before.plan.hash != after.plan.hash

    run_fleet(main, framed())


def test_the_plot_of_a_path_is_in_coordinates(tmp_path: Path) -> None:
    fleet, file, picture = tmp_path / "a.fleet.yaml", tmp_path / "a.job.yaml", tmp_path / "a.svg"
    fleet.write_text(json.dumps(framed().to_plain(), default=str))
    file.write_text(json.dumps(square().to_plain(), default=str))
    at = [f"--at={axis}={value}" for axis, value in zip(ALONE, to_axes(50, 0), strict=True)]
    words = ["path", "plot", str(file), "--fleet", str(fleet), *at, "-o", str(picture)]
    shown = CliRunner().invoke(main, words)
    assert shown.exit_code == 0, shown.output
    assert "in frame plate" in shown.output and picture.exists()
