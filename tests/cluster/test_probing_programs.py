"""Programs in G-code that probe, against the truth of simulated contacts."""

from pathlib import Path

import pytest
from cluster.test_probe import Bench, run_bench, with_touch
from cluster.worlds import changed

from orchestrator.client.steps import JobFailed
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport
from orchestrator.model.templates.template import load_job

READY = "{do: enable, axes: [gantry]}, {do: home, axes: [gantry]}, {do: move, to: {gantry.x: 20, gantry.y: 5}}"
TWICE = """\
G21 G91
G38.2 Z-3 F300
G0 Z0.2
G38.2 Z-2 F60
{zero}
G0 Z5
G90 G0 Y12
G1 Z-1 F300
G3 Y14 J1
G0 Z8
"""


def load_program(
    folder: Path, text: str, *, start: str = "[5, 20]", probe: str = "gantry.touch", more: str = ""
) -> Job:
    """The job of a program whose Z is gantry.x, the axis of the bench, and whose Y is gantry.y."""
    (folder / "part.ngc").write_text(text, encoding="utf-8")
    file = folder / "part.job.yaml"
    step = f"do: path, file: part.ngc, axes: {{Y: gantry.y, Z: gantry.x}}, start: {start}, tolerance: 100 um"
    file.write_text(
        f"schema: tutti.job/1\nname: part\nsteps:\n  - {{{step}, gcode: {{probe: {probe}}}{more}}}\n", encoding="utf-8"
    )
    return load_job(file)


async def run_program(bench: Bench, program: Job) -> JobReport:
    try:
        return await bench.client.run(program)
    except JobFailed as failed:
        return failed.report


@pytest.mark.parametrize("zero", ["G92 Z0.5", "G10 L20 P1 Z0.5"])
def test_a_program_finds_its_zero_and_cuts_from_there(tmp_path: Path, zero: str) -> None:
    program = load_program(tmp_path, TWICE.format(zero=zero).replace("G3 Y14 J1", "G19 G3 Y14 J1"))

    async def main(bench: Bench) -> None:
        bench.put_contact(-1400)
        forecast = await bench.client.dry_run(program)
        assert not forecast.problems, forecast.problems
        report = await run_program(bench, program)
        assert report.state == "done", report.reason
        assert bench.contact is not None
        contacts = [made.counts for made in bench.contact.made]
        # The contact is at 0.5 mm, and the program ends at 8 mm.
        assert bench.find_rest() == pytest.approx(contacts[-1] + 7500, abs=3)
        fast, slow = [step.probe for step in report.steps if step.probe is not None]
        for probed in (fast, slow):
            assert probed.least <= 20 - 1.4 <= probed.most and probed.overtravel <= probed.stated
        assert slow.start == pytest.approx(20 - 1.4 + 0.2, abs=0.01)
        (state,) = [axis for name, axis in (await bench.client.status())["gantry"].axes.items() if name == "x"]
        assert state.position == pytest.approx(8, abs=0.001)

    run_bench(main, axis="gantry.x", ready=READY)


def test_places_of_the_program_need_no_zero(tmp_path: Path) -> None:
    """Heights of a board, as programs for autolevelling probe them: the axis goes back to a place each time."""
    text = "G90\nG38.2 Z18 F600\nG0 Z20\nG0 Y6\nG38.3 Z18 F600\nG0 Z20\nG38.3 Z19 F600\nG91\nG0 Z1\nG90\nG0 Z15\nY5\n"
    program = load_program(tmp_path, text)

    async def main(bench: Bench) -> None:
        bench.put_contact(-1400)
        report = await run_program(bench, program)
        assert report.state == "done", report.reason
        probed = [step.probe for step in report.steps if step.probe is not None]
        assert [each.touched for each in probed] == [True, True, False]
        assert bench.find_rest() == bench.start - 5000
        assert bench.virtual.controllers["gantry"].position("Y") == 5000

    run_bench(main, axis="gantry.x", ready=READY)


def test_what_follows_is_checked_for_all_that_a_contact_may_be(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        # The zero is somewhere from 5 mm to 20 mm, and the program goes 20 mm below it.
        for text in ("G0 Z5\nG0 Z-20", "G1 F600 Z5\nZ-20", "G91\nG0 Z-20"):
            program = load_program(tmp_path, f"G90\nG38.2 Z5 F600\nG92 Z0\n{text}\n")
            forecast = await bench.client.dry_run(program)
            assert [problem.code for problem in forecast.problems] == ["soft-limit"], forecast.problems
            deep = await bench.client.dry_run(load_program(tmp_path, f"G90\nG38.2 Z12 F600\nG92 Z0\n{text}\n"))
            assert not deep.problems

    run_bench(main, axis="gantry.x", ready=READY)


@pytest.mark.parametrize(
    ("text", "start", "code", "words"),
    [
        ("G90\nG38.2 Z19 F120\nG0 Z20", "[5, 20]", "not-touched", "up to 19 mm"),
        ("G90\nG38.2 Z8 F120\nG0 Z20", "[5, 19]", "other-start", "gantry.x is at 20 mm; the probe begins at 19 mm"),
        ("G90\nG38.4 Z8 F120\nG0 Z20", "[5, 20]", "line-level", "input touch is passive already"),
        ("G90\nG38.2 Y8 F120\nG0 Y20", "[5, 20]", "not-touched", "up to 8 mm of gantry.y"),
    ],
)
def test_what_the_machine_cannot_do_is_refused_with_its_line(
    tmp_path: Path, text: str, start: str, code: str, words: str
) -> None:
    program = load_program(tmp_path, text, start=start)

    async def main(bench: Bench) -> None:
        report = await run_program(bench, program)
        step = report.steps[-1]
        assert step.name == "line 2" and step.refused is not None and step.refused.code == code, report.reason
        assert words in step.refused.text

    run_bench(main, axis="gantry.x", ready=READY)


def test_what_is_left_of_a_job_needs_its_probe() -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(-1400)
        edge = "{do: probe, name: EDGE, to: {gantry.x: 18}, until: gantry.touch, speed: 5 mm/s}"
        report = await bench.run(edge, "{do: move, to: {gantry.x: {of: EDGE.x, between: [0, 1]}}}")
        assert report.steps[-1].refused is not None and report.steps[-1].refused.code == "measured-bounds"
        with pytest.raises(Refusal, match=r"goes by EDGE\.x, which was measured before"):
            await bench.client.find_rest(report.job_id)

    run_bench(main, axis="gantry.x", ready=READY)


def test_a_host_probes_where_the_program_says_so(tmp_path: Path) -> None:
    program = load_program(
        tmp_path, "G90\nG38.2 Z18 F120\nG92 Z0\nG0 Z1", probe="{input: gantry.touch, by: host}", more=", speed: 1 mm/s"
    )

    async def main(bench: Bench) -> None:
        bench.put_contact(-1400)
        report = await run_program(bench, program)
        assert report.state == "done", report.reason
        probed = report.steps[0].probe
        assert probed is not None and probed.by == "host" and probed.overtravel is not None
        # The axis goes back to the contact, which the host knows by its polls alone.
        assert bench.contact is not None
        assert bench.find_rest() == pytest.approx(bench.contact.made[0].counts + 1000, abs=200)

    run_bench(main, changed(with_touch()), "gantry.x", READY)
