"""Timelines and plots of one virtual run: their numbers are those of its report and its recordings."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import pytest
from cluster.worlds import PREPARE, job, outcome, run_fleet
from matplotlib.container import ErrorbarContainer

from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.report import JobReport, StepRecording, StepReport
from orchestrator.monitor.job_plot import plot_recordings
from orchestrator.monitor.timeline.picture import draw_step
from orchestrator.monitor.timeline.stages import StepTimeline, TimelineStage, make_timeline
from orchestrator.runtime.virtual.fleet import VirtualFleet

THERE = "{do: move, to: {gantry.x: 20, stage.u: 4}, name: there}"
BACK = "{do: move, to: {gantry.x: 0, gantry.y: 5, stage.u: 0}}"
RUN = f"[{THERE}, {BACK}, {{do: enable, axes: [gantry]}}, {{do: move, to: {{gantry.x: 10, gantry.y: 0}}}}]"


class LookedAt(NamedTuple):
    """A job that has run. recordings: by step."""

    report: JobReport
    recordings: Mapping[int, StepRecording]


@pytest.fixture(scope="module")
def run() -> LookedAt:
    async def main(fleet: VirtualFleet) -> LookedAt:
        await outcome(fleet, PREPARE)
        report = await outcome(fleet, job(RUN))
        assert report.state == "done", report.reason
        client = fleet.make_client()
        recordings = {index: await client.load_recording(report.job_id, index) for index in (0, 1, 3)}
        return LookedAt(report, {index: each for index, each in recordings.items() if each is not None})

    return run_fleet(main)


def of_step(run: LookedAt, index: int) -> tuple[StepReport, StepTimeline]:
    timeline = {each.step: each for each in make_timeline(run.report).steps}
    return run.report.steps[index], timeline[index]


def stage(step: StepTimeline, name: str) -> TimelineStage:
    (found,) = [each for each in step.coordinator if each.name == name]
    return found


def test_a_timeline_has_the_motion_steps_only(run: LookedAt) -> None:
    timeline = make_timeline(run.report)
    assert [each.step for each in timeline.steps] == [0, 1, 3]
    assert type(timeline).model_validate_json(timeline.to_json()) == timeline


def test_stages_of_the_coordinator_have_the_instants_of_the_report(run: LookedAt) -> None:
    report, step = of_step(run, 0)
    t0_ns = report.t0_fleet_ns or 0
    assert [each.name for each in step.coordinator] == ["plan", "arm", "commit", "decide", "go", "fire", "run"]
    went = {each.state: (each.fleet_ns or 0) - t0_ns for each in reversed(run.report.transitions)}
    assert stage(step, "plan").begin_ns == went["planning"]
    assert stage(step, "arm").begin_ns == (report.arming_fleet_ns or 0) - t0_ns
    assert stage(step, "commit").begin_ns == went["armed"]
    assert stage(step, "decide").begin_ns == (report.settled_fleet_ns or 0) - t0_ns
    assert stage(step, "go").begin_ns == went["committed"]
    assert stage(step, "fire").end_ns == stage(step, "run").begin_ns == 0
    ends = [axis.end.latest_ns for each in report.members.values() for axis in each.evidence.values() if axis.end]
    assert stage(step, "run").end_ns == max(ends) - t0_ns
    bounds = [(each.begin_ns, each.end_ns) for each in step.coordinator]
    assert all(before[1] == after[0] for before, after in pairwise(bounds))
    assert bounds == sorted(bounds)


@pytest.mark.parametrize("index", [0, 1, 3])
def test_members_have_their_stages_starts_and_ends(run: LookedAt, index: int) -> None:
    report, step = of_step(run, index)
    t0_ns = report.t0_fleet_ns or 0
    assert list(step.members) == list(report.members)
    for name, member in report.members.items():
        shown = step.members[name]
        assert [each.name for each in shown.stages] == ["prepare", *member.stages_ns]
        assert shown.stages[0].begin_ns == (member.arming_fleet_ns or 0) - t0_ns
        assert shown.stages[-1].end_ns - shown.stages[0].begin_ns == member.armed_in_ns
        took = {each.name: each.end_ns - each.begin_ns for each in shown.stages[1:]}
        assert took == member.stages_ns
        # The adapter arms between the coordinator's request and the promises, or the start of a step of one controller.
        first, last = ("start", "start") if index == 3 else ("arm", "commit")
        assert stage(step, first).begin_ns <= shown.stages[0].begin_ns
        assert shown.stages[-1].end_ns <= stage(step, last).end_ns
        for axis, evidence in member.evidence.items():
            assert shown.axes[axis].start.earliest_ns == evidence.start.earliest_ns - t0_ns
            assert shown.axes[axis].start.latest_ns == evidence.start.latest_ns - t0_ns


def test_a_step_behind_another_one_says_which_stages_it_does_not_have(run: LookedAt) -> None:
    report, step = of_step(run, 1)
    assert report.chain is not None and report.chain.kept
    assert [each.name for each in step.coordinator] == ["arm", "commit", "fire", "run"]
    assert any("behind step 1" in each for each in step.remarks)
    assert any("no transitions" in each for each in step.remarks)
    _, rested = of_step(run, 3)
    assert stage(rested, "plan").begin_ns > -2_000_000_000


def test_a_report_of_an_earlier_version_has_no_begin_of_arming(run: LookedAt) -> None:
    plain = run.report.to_plain()
    for step in plain["steps"]:
        for member in step["members"].values():
            del member["arming_fleet_ns"]
    step = make_timeline(JobReport.model_validate(plain)).steps[0]
    assert {member.stages[0].begin_ns for member in step.members.values()} == {stage(step, "arm").begin_ns}
    assert any("began to arm" in each for each in step.remarks)


def test_a_picture_has_each_stage_and_each_start_as_an_interval(run: LookedAt) -> None:
    _, step = of_step(run, 0)
    figure = draw_step(step, "step 0")
    main, zoom = figure.axes
    rows = [text.get_text() for text in main.get_yticklabels()]
    assert rows == ["coordinator", "gantry.x", "stage.u"]
    bars = [(each.get_x(), each.get_width()) for each in main.patches]  # type: ignore[attr-defined]
    for each in step.coordinator:
        width = (each.end_ns - each.begin_ns) / NS_PER_MS
        assert any(bar == pytest.approx((each.begin_ns / NS_PER_MS, width)) for bar in bars)
    intervals = [each for each in zoom.containers if isinstance(each, ErrorbarContainer)]
    assert len(intervals) == 2
    low, high = zoom.get_xlim()
    for each, member, axis in zip(intervals, ("gantry", "stage"), "xu", strict=True):
        went = step.members[member].axes[axis]
        start = went.modelled or went.start
        left, right = each.lines[2][0].get_segments()[0][:, 0]
        assert (left, right) == pytest.approx((start.earliest_ns / NS_PER_MS, start.latest_ns / NS_PER_MS))
        assert low < left < right < high
    assert main.get_legend() is None and figure.legends


def test_a_plot_of_a_job_has_all_steps_on_one_scale_of_time(run: LookedAt) -> None:
    figure = plot_recordings(list(run.recordings.values()), "job", None, run.report.steps)
    grid = [figure.axes[row * 3 : row * 3 + 3] for row in range(3)]
    assert [row[0].get_ylabel() for row in grid] == ["gantry.x, mm", "stage.u, mm", "gantry.y, mm"]
    first_ns = run.recordings[0].t0_fleet_ns
    seen: list[Any] = [line.get_xydata() for line in grid[0][0].lines if line.get_marker() == "."]
    assert len(seen) == 3
    for points, (_, recording) in zip(seen, run.recordings.items(), strict=True):
        axis = recording.axes["gantry.x"]
        wanted = [((at_ns - first_ns) / 1e9, counts / axis.counts_per_unit) for at_ns, counts in axis.sampled]
        assert [tuple(each) for each in points] == [pytest.approx(each) for each in wanted]
    planned: list[Any] = [line.get_xydata() for line in grid[0][0].lines if line.get_marker() != "."]
    assert [float(line[-1][1]) for line in planned if len(line) > 2] == pytest.approx([20, 0, 10], abs=0.01)
    low, high = grid[0][0].get_xlim()
    assert all(low <= line[0][0] and line[-1][0] <= high for line in planned)


def test_a_plot_has_starts_and_ends_as_intervals(run: LookedAt) -> None:
    figure = plot_recordings(list(run.recordings.values()), "job", None, run.report.steps)
    timing = figure.axes[2]
    starts, ends = (each for each in timing.containers if isinstance(each, ErrorbarContainer))
    assert (starts.get_label(), ends.get_label()) == ("start", "end")
    steps = [run.report.steps[index] for index in run.recordings]
    wanted: list[tuple[float, float]] = []
    for step in steps:
        start = step.members["gantry"].evidence["x"].start_for_verdict
        wanted.append(tuple((each - (step.t0_fleet_ns or 0)) / 1e6 for each in (start.earliest_ns, start.latest_ns)))  # type: ignore[arg-type]
    assert [tuple(each[:, 1]) for each in starts.lines[2][0].get_segments()] == [pytest.approx(each) for each in wanted]
    # A simulated controller keeps to its plan.
    for low, high in (each[:, 1] for each in ends.lines[2][0].get_segments()):
        assert -10 < low < high < 10 and low < 1 and high > -1


def test_a_plot_without_reports_has_no_column_of_starts(run: LookedAt) -> None:
    assert len(plot_recordings([run.recordings[0]], "step").axes) == 4
