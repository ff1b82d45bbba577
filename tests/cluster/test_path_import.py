"""A program in G-code becomes a job, and the axes do what it says."""

import pytest
from cluster.worlds import PREPARE, outcome, run_fleet

from orchestrator.model.jobs.job import Job
from orchestrator.model.paths.files.base.imported import make_job
from orchestrator.model.paths.files.gcode.reader import GcodeReader
from orchestrator.runtime.virtual.fleet import VirtualFleet

PROGRAM = """G21 G90 G64 P0.05 F3000
G1 X50 Y0
G3 X60 Y10 I0 J10
G1 X60 Y60
G61
G1 X0 Y60
G1 X0 Y0
"""


def test_axes_without_a_limit_of_jerk_follow_a_program() -> None:
    async def main(fleet: VirtualFleet) -> None:
        steps = GcodeReader("part.ngc", {"X": "gantry.x", "Y": "gantry.y"}).read_steps(PROGRAM.splitlines())
        job = Job.model_validate(make_job("part", [{**step, "tolerance": "300 um"} for step in steps]))
        begun = len(fleet.controllers["gantry"].commanded_motions)
        report = await outcome(fleet, PREPARE, job)
        assert report.state == "done", report.reason
        moved = fleet.controllers["gantry"].commanded_motions[begun:]
        assert {each.axis for each in moved} == {"X", "Y"}
        (step,) = report.steps
        assert step.planned_s == pytest.approx(4.95, abs=0.2)
        for motor in "XY":
            assert fleet.controllers["gantry"].position(motor) == pytest.approx(0, abs=1)

    run_fleet(main)
