"""Positions that controllers record by themselves during a step, against the true motions."""

import asyncio
from collections.abc import Sequence
from pathlib import Path

import pytest
from cluster.recordings import RecordedFleet, read_messages
from cluster.worlds import EXAMPLES, PREPARE, job, outcome, refusal, run_fleet

from orchestrator.bus.base import BusSample
from orchestrator.model.operation.recording import StepSamples
from orchestrator.model.report import JobReport
from orchestrator.monitor.export.recorded import load_run
from orchestrator.monitor.export.samples import make_device_table
from orchestrator.monitor.recording.reader import Recording
from orchestrator.runtime.virtual.fleet import VirtualFleet
from tutti import Job, JobFailed, Move, Tutti
from tutti.testing import VirtualTestbed, virtual_fleet

DEMO = EXAMPLES / "demo.fleet.yaml"


async def run_sampled(tutti: Tutti, *steps: Move) -> tuple[JobReport, list[StepSamples]]:
    """Run a job; its report, and what was sampled."""
    found: list[StepSamples] = []

    def take(sample: BusSample) -> None:
        found.append(StepSamples.model_validate_json(sample.payload))

    subscription = await tutti.bus.subscribe(tutti.keys.job_samples(), take)
    report = await tutti.run(Job("sampled", list(steps), max_start_skew="60 ms"))
    await asyncio.sleep(0.1)
    await subscription.undeclare()
    return report, found


def check_against_truth(fleet: VirtualTestbed, samples: StepSamples, axis: str) -> float:
    """Every sample lies where the axis truly was within its bound; return the largest distance at its own instant."""
    truth, sampled = fleet.truth(axis), samples.axes[axis.partition(".")[2]]
    worst = 0.0
    for number, counts in enumerate(sampled.counts):
        at_s = samples.fleet_ns[number] / 1e9
        bound_s = samples.bound_ns / 1e9
        around = [truth.position_at(at_s + shift) for shift in (-bound_s, -bound_s / 2, 0, bound_s / 2, bound_s)]
        position = counts / sampled.counts_per_unit
        assert min(around) - 0.002 <= position <= max(around) + 0.002, (number, at_s, position, around)
        worst = max(worst, abs(position - around[2]))
    return worst


def periods(samples: StepSamples) -> float:
    """The mean time between samples, ns."""
    return (samples.fleet_ns[-1] - samples.fleet_ns[0]) / (len(samples.fleet_ns) - 1)


def test_samples_are_where_the_axis_truly_was_within_their_bound() -> None:
    with virtual_fleet(DEMO) as fleet:
        fleet.tutti.enable("gantry", "stage")
        fleet.tutti.home()
        fleet.advance("20 s")
        move = Move(to={"gantry.x": 100, "gantry.y": 30, "stage.u": 2}, record={"axes": ["gantry"], "period": "2 ms"})
        report, (samples,) = fleet.run(lambda tutti: run_sampled(tutti, move))
        (step,) = report.steps
        assert report.state == "done" and step.sampling is not None
        assert step.sampling.samples == {"gantry": len(samples.axes["x"].counts)} and not step.sampling.problem
        assert samples.step == step.index and samples.controller == "gantry"
        assert periods(samples) == pytest.approx(1.953125e6, rel=1e-3)
        assert samples.bound_ns < 4_000_000
        # The whole motion is in it: from rest to rest.
        x = samples.axes["x"].counts
        assert x[0] == 0 and x[-1] == 100_000 and len(set(x)) > 50
        assert step.t0_fleet_ns is not None and samples.fleet_ns[0] < step.t0_fleet_ns
        for axis in ("gantry.x", "gantry.y"):
            check_against_truth(fleet, samples, axis)
        # Nothing is left in the controller: the next step has room again.
        again, more = fleet.run(
            lambda tutti: run_sampled(tutti, Move(to={"gantry.x": 0}, record={"axes": ["gantry.x"], "period": "4 ms"}))
        )
        assert again.state == "done" and periods(more[0]) == pytest.approx(3.90625e6, rel=1e-3)
        assert more[0].axes["x"].counts[-1] == 0


def test_a_serial_controller_samples_as_densely_and_is_fetched_in_its_time() -> None:
    with virtual_fleet(EXAMPLES / "smc2000.fleet.yaml") as fleet:
        names = list(fleet.fleet.axis_names)
        controller = names[0].partition(".")[0]
        fleet.tutti.enable(controller)
        fleet.tutti.home(controller)
        fleet.advance("20 s")
        move = Move(to={names[0]: 20}, record={"axes": [names[0]], "period": "2 ms"})
        report, (samples,) = fleet.run(lambda tutti: run_sampled(tutti, move))
        assert report.state == "done" and report.steps[0].sampling is not None
        assert report.steps[0].sampling.samples[controller] > 100
        check_against_truth(fleet, samples, names[0])


def test_the_positions_that_a_drive_sends_by_itself_are_samples() -> None:
    with virtual_fleet(EXAMPLES / "cia402.fleet.yaml") as fleet:
        axis = fleet.fleet.axis_names[0]
        controller = axis.partition(".")[0]
        fleet.tutti.enable(controller)
        fleet.tutti.home(controller)
        fleet.advance("5 s")
        report, (samples,) = fleet.run(
            lambda tutti: run_sampled(tutti, Move(to={axis: 30}, record={"axes": [axis], "period": "20 ms"}))
        )
        assert report.state == "done" and len(samples.fleet_ns) > 20
        assert samples.bound_ns < 4_000_000
        check_against_truth(fleet, samples, axis)
        with pytest.raises(JobFailed, match="the drive sends its position every 10 ms; write a period of at least 10"):
            fleet.run(lambda tutti: run_sampled(tutti, Move(to={axis: 0}, record={"axes": [axis], "period": "2 ms"})))


def test_samples_are_in_the_recording_of_the_job(tmp_path: Path) -> None:
    async def main(virtual: VirtualFleet) -> RecordedFleet:
        recorded = RecordedFleet(virtual, tmp_path)
        await recorded.recorder.start()
        running = asyncio.ensure_future(recorded.recorder.run())
        await outcome(
            virtual, PREPARE, job("[{do: move, to: {gantry.x: 20}, record: {axes: [gantry.x], period: 5 ms}}]")
        )
        await asyncio.sleep(4)
        running.cancel()
        await recorded.recorder.close()
        return recorded

    recorded = run_fleet(main)
    (message,) = read_messages(recorded.files("job")[-1], lambda key: key.endswith("/samples"))
    samples = StepSamples.model_validate_json(message.payload)
    assert samples.axes["x"].counts[-1] == 20_000
    with Recording(recorded.files("job")[-1]) as recording:
        table = make_device_table(load_run(recording))
    columns = table.columns
    assert list(columns["position"]) == [counts / 1000 for counts in samples.axes["x"].counts]
    assert all(
        t_hi - t_lo == 2 * samples.bound_ns for t_lo, t_hi in zip(columns["t_lo_ns"], columns["t_hi_ns"], strict=True)
    )
    assert set(columns["axis"]) == {"gantry.x"} and set(columns["unit"]) == {"mm"}


@pytest.mark.parametrize(
    ("record", "code", "texts"),
    [
        ("{axes: [gantry.x], period: 1 ms}", "sampling-period", ["1 ms is too short", "1.953 ms", "at least 1.96 ms"]),
        ("{axes: [stage.u], period: 10 ms}", "no-sampling", ["cannot record positions by itself", "remove `record`"]),
        ("{axes: [gantry.z], period: 5 ms}", "unknown-name", ["gantry.z"]),
    ],
)
def test_what_cannot_be_sampled_is_refused_and_nothing_moves(record: str, code: str, texts: Sequence[str]) -> None:
    async def main(virtual: VirtualFleet) -> None:
        move = job(f"[{{do: move, to: {{gantry.x: 20}}, record: {record}}}]")
        refused = await refusal(virtual, PREPARE, move)
        assert refused.code == code
        said = f"{refused.text}; {refused.remedy}"
        assert all(text in said for text in texts), said
        assert virtual.controllers["gantry"].position("X") == 0

    run_fleet(main)


def test_too_many_samples_are_refused_with_a_period_that_fits() -> None:
    async def main(virtual: VirtualFleet) -> None:
        slow = "{do: move, to: {gantry.x: 400, gantry.y: 200}, speed: 0.08, record: {axes: [gantry], period: 2 ms}}"
        refused = await refusal(virtual, PREPARE, job(f"[{slow}]"))
        assert refused.code == "sampling-space" and "there is room for" in refused.text
        least_ms = float(refused.remedy.split("at least ")[1].split(" ms")[0])
        report = await outcome(virtual, job(f"[{slow.replace('2 ms', f'{2 * least_ms} ms')}]"))
        assert report.state == "done" and report.steps[0].sampling is not None

    run_fleet(main)


def test_a_sampled_step_begins_and_ends_at_rest_and_the_report_says_why() -> None:
    async def main(virtual: VirtualFleet) -> None:
        plain, sampled = "{do: move, to: {gantry.x: 20}}", "{do: move, to: {gantry.x: 0}, record: {axes: [gantry.x]}}"
        report = await outcome(virtual, PREPARE, job(f"[{plain}, {sampled}, {plain}]"))
        broken = [step.chain.broken for step in report.steps if step.chain is not None]
        assert broken == [f"controllers record positions {when} it (`record`)" for when in ("for", "before")]

    run_fleet(main)
