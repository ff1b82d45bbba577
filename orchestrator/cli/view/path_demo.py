"""`tutti demo --path`: a figure of eight on controllers of two makes, with its bound and the truth."""

from pathlib import Path

import click

from orchestrator.cli.base.codes import FAILED
from orchestrator.cli.base.common import console, print_json
from orchestrator.cli.base.errors import expected_errors
from orchestrator.cli.base.pictures import write_picture

SAMPLES = 2000


def run_path(out: Path | None, *, wanted: bool, as_json: bool) -> None:
    """Run the example of a path in virtual time, print bound and truth, and write a picture to `out`. wanted: whether
    it was asked for; a picture alone is bad input."""
    if not wanted:
        raise click.UsageError("-o is the picture of a path; add --path")
    import numpy as np

    from orchestrator.model.jobs.files import load_fleet
    from orchestrator.model.templates.template import load_job
    from orchestrator.monitor.path_demo_plot import SampledPath, plot_sampled_path
    from orchestrator.monitor.path_words import describe_path
    from orchestrator.runtime.examples import find_example
    from orchestrator.runtime.virtual.path_demo import run_path_demo

    fleet, job = load_fleet(find_example("path.fleet.yaml")), load_job(find_example("path.job.yaml"))
    with expected_errors():
        demo = run_path_demo(fleet, job)
    report = next(step.path for step in demo.report.steps if step.path is not None)
    assert report.bound is not None
    worst = float(demo.errors.max())
    summary = {
        "state": demo.report.state,
        "path": report.to_plain(),
        "truth": {
            "instants": len(demo.errors),
            "largest": round(worst, 6),
            "p99": round(float(np.percentile(demo.errors, 99)), 6),
            "within_bound": worst <= report.bound.predicted,
        },
        "samples": {axis: len(sample.times_s) for axis, sample in demo.samples.items()},
        "file": None if out is None else str(out),
    }
    if out is not None:
        times_s = np.linspace(0.0, demo.plan.duration_s, SAMPLES)
        drawn_path = SampledPath(
            axes=demo.axes,
            times_s=times_s,
            planned=demo.plan.evaluate(times_s).positions,
            samples={axis: (sample.times_s, sample.positions) for axis, sample in demo.samples.items()},
            truth_s=demo.times_s,
            errors=demo.errors,
            bound=report.bound,
        )
        makes = ", ".join(dict.fromkeys(controller.adapter for controller in fleet.controllers.values()))
        title = f"{job.name}: {report.length:.0f} {demo.unit} in {report.duration_s:.1f} s, {makes}"
        write_picture(plot_sampled_path(drawn_path, title), out)
    if as_json:
        print_json(summary)
    else:
        for line in describe_path(report):
            console.print(line, highlight=False, markup=False, soft_wrap=True)
        distance_text = f"{worst:.3g} {demo.unit} at most, at {len(demo.errors)} instants"
        console.print(f"true distance from the path: {distance_text}", highlight=False)
        if out is not None:
            console.print(str(out), highlight=False, markup=False, soft_wrap=True)
    if worst > report.bound.predicted:
        raise SystemExit(FAILED)
