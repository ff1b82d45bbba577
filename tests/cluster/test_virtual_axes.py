"""Moves of virtual axes on a table of three makes and a slit: targets, straight lines by truth, and what is refused."""

import asyncio
from fractions import Fraction

import numpy as np
import pytest
from cluster.worlds import EXAMPLES, changed, job, outcome, run_fleet

from orchestrator.bus.base import BusSample
from orchestrator.clock.base import sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet

PREPARE = "{do: enable, axes: [table, slit]}, {do: home, axes: [table, slit]}, {do: move, to: flat}"
SAMPLE_NS = 2_000_000
COUNT_MM = 1 / 2000


def table_fleet() -> Fleet:
    return load_fleet(EXAMPLES / "table.fleet.yaml")


def read_truth(fleet: VirtualFleet, group: str) -> tuple[Fraction, ...]:
    """The true positions of virtual axes, by the simulators' motors."""
    positions: list[Fraction] = []
    virtual_map = fleet.fleet.virtual_axes.maps[group]
    for name in virtual_map.real:
        axis = fleet.fleet.axis(name)
        counts = fleet.controllers[name.partition(".")[0]].position(axis.motors[0])
        positions.append(Fraction(counts) / axis.counts_per_unit)
    return virtual_map.to_virtual(positions)


async def run_watched(
    fleet: VirtualFleet, steps: str, group: str = "table"
) -> tuple[JobReport, list[tuple[float, ...]]]:
    """Run steps, with the true positions of a group meanwhile."""
    seen: list[tuple[float, ...]] = []

    async def watch() -> None:
        while True:
            seen.append(tuple(map(float, read_truth(fleet, group))))
            await sleep_ns(fleet.clock, SAMPLE_NS)

    watching = asyncio.get_running_loop().create_task(watch())
    report = await outcome(fleet, job(f"[{steps}]"))
    watching.cancel()
    return report, seen


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 201))])
def test_a_table_of_three_makes_stays_level_while_it_rises(seed: int) -> None:
    """Within the bound that is stated ahead, by truth; the other virtual axes of the group keep their positions."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{table.pitch: 3 mrad, table.roll: -1}}}}]"))
        begun = tuple(map(float, read_truth(fleet, "table")))
        report, seen = await run_watched(fleet, "{do: move, to: {table.height: 8}}")
        assert report.state == "done" and report.verdict == "green", report.reason
        bounds = report.steps[0].virtual
        for number, name in ((1, "table.pitch"), (2, "table.roll")):
            off = max(abs(sample[number] - begun[number]) for sample in seen)
            assert COUNT_MM < off <= bounds[name].most, name
        assert abs(float(read_truth(fleet, "table")[0]) - 8) <= COUNT_MM

    run_fleet(main, table_fleet(), seed)


def test_virtual_positions_are_reached_by_real_ones_and_come_back_exactly() -> None:
    async def main(fleet: VirtualFleet) -> None:
        steps = (
            "{do: move, to: {slit.gap: 5, slit.centre: 1}}",
            "{do: move, by: {slit.centre: 500 um}}",
            "{do: repeat, times: 10, steps: [{do: move, by: {slit.gap: 0.0333}}, {do: move, by: {slit.gap: -0.0333}}]}",
            "{do: move, to: {slit.gap: 4}, by: {table.roll: 1 mrad}, speed: {slit.gap: 2 mm/s}}",
            "{do: move, to: open}",
        )
        report, _ = await run_watched(fleet, f"{PREPARE}, {', '.join(steps)}")
        assert report.state == "done", report.reason
        assert read_truth(fleet, "slit") == (5, 0)
        by_speed = report.steps[-2]
        assert by_speed.planned_s is not None and by_speed.planned_s >= 1 / 2

    run_fleet(main, table_fleet())


def test_states_of_virtual_axes_are_published_with_their_real_ones() -> None:
    async def main(fleet: VirtualFleet) -> None:
        published: list[VirtualState] = []

        def receive(sample: BusSample) -> None:
            published.append(VirtualState.read_message(sample.payload))

        client = fleet.make_client()
        assert "is not referenced" in (await client.virtual_states())["slit"].obstacle
        await outcome(fleet, job(f"[{PREPARE}]"))
        await client.bus.subscribe(client.keys.virtual("table"), receive)
        _, seen = await run_watched(fleet, "{do: move, to: {table.height: 8, table.pitch: 2}}")
        heights = np.array([sample[0] for sample in seen])
        moving = [state for state in published if state.moving]
        assert len(moving) > 5
        for state in moving:
            height = state.axes["height"]
            # Each was there at some instant: the true way is continuous.
            assert height.low <= heights.max() and height.high >= heights.min()
            assert height.low <= height.position <= height.high
        assert await client.position("table.height") == pytest.approx(8, abs=COUNT_MM)
        async for positions in client.positions(["table.pitch", "front.upper"]):
            assert positions["table.pitch"] == pytest.approx(2, abs=5 * COUNT_MM)
            break
        with pytest.raises(Refusal, match="did you mean table"):
            await client.position("table.pitsch")
        final_state = (await client.virtual_states())["table"]
        assert final_state.obstacle == "" and final_state.enabled and final_state.referenced
        assert final_state.axes["height"].position == pytest.approx(8, abs=COUNT_MM)
        assert final_state.axes["pitch"].position == pytest.approx(2, abs=5 * COUNT_MM)

    run_fleet(main, table_fleet())


def test_they_are_moved_live_and_what_a_retry_depends_on_is_named() -> None:
    async def main(fleet: VirtualFleet) -> None:
        report = await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{table.pitch: 1 mrad}}}}]"))
        client = fleet.make_client()
        async with client.live("slit") as live:
            await live.move({"slit.gap": 3, "slit.centre": 1})
            await live.move(by={"slit.gap": -1})
        assert read_truth(fleet, "slit") == (2, 1)
        retried = await client.retry_job(report.job_id, 3, dry_run=True)
        assert [axis.axis for axis in retried.axes] == ["front.jack", "left.jack", "right.jack"]
        text = "step 4 depends on where front.jack, left.jack, right.jack stand"
        assert [warning.partition(":")[0] for warning in retried.warnings] == [text]

    run_fleet(main, table_fleet())


def test_the_real_axes_are_leased_and_a_fault_of_one_names_it() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE}]"))
        client = fleet.make_client()
        job_id = await client.submit(job("[{do: move, to: {table.height: 15}, speed: 0.1}]"))
        async with asyncio.timeout(60):
            while not (await client.virtual_states())["table"].moving:
                await asyncio.sleep(0.05)
        leases = {(lease.controller, lease.axis) for lease in await client.list_leases() if lease.holder}
        assert {"front", "left", "right"} <= {controller for controller, _ in leases}
        await client.stop()
        report = await client.wait_for_job(job_id)
        assert report.state in ("aborted", "failed", "cancelled", "interrupted")
        height, pitch, roll = read_truth(fleet, "table")
        assert 0 < height < 15 and abs(pitch) < 1 and abs(roll) < 1

    run_fleet(main, table_fleet())


def test_a_path_is_given_in_virtual_axes() -> None:
    """A circle of gap and centre, from rest to rest, by the simulators' motors."""

    async def main(fleet: VirtualFleet) -> None:
        report, _ = await run_watched(fleet, f"{PREPARE}, {{do: move, to: {{slit.gap: 6, slit.centre: 1}}}}")
        assert report.state == "done", report.reason
        circle = "{piece: arc, to: [6, 1], centre: [4, 1]}"
        axes = "axes: [front.upper, front.lower]"
        path = f"{{do: path, {axes}, frame: slit, start: [6, 1], pieces: [{circle}], tolerance: 50 um}}"
        report, seen = await run_watched(fleet, path, "slit")
        assert report.state == "done", report.reason
        bound = report.steps[0].path.bound if report.steps[0].path else None
        assert bound is not None and bound.predicted <= 0.05
        off = max(abs(np.hypot(gap - 4, centre - 1) - 2) for gap, centre in seen)
        # The bound is a distance of real axes; of a slit, gap and centre are off by up to 1.5 times that.
        assert off <= 1.5 * bound.predicted and max(gap for gap, _ in seen) - min(gap for gap, _ in seen) > 3.9

    run_fleet(main, table_fleet())


def test_overruns_of_real_axes_are_in_the_bound() -> None:
    """One jack is approached from below, so that it goes beyond its target when the table sinks."""
    play = {"backlash": {"amount": 0.1, "approach": "positive", "overrun": 0.5}}
    fleet_file = changed(table_fleet(), front={"axes": {"jack": play}})

    async def main(fleet: VirtualFleet) -> None:
        report, _ = await run_watched(fleet, f"{PREPARE}, {{do: move, to: {{table.height: 8}}}}")
        assert report.state == "done", report.reason
        begun = tuple(map(float, read_truth(fleet, "table")))
        report, seen = await run_watched(fleet, "{do: move, to: {table.height: 5}}")
        assert report.state == "done", report.reason
        off = max(abs(sample[1] - begun[1]) for sample in seen)
        assert 0.5 < off <= report.steps[0].virtual["table.pitch"].most

    run_fleet(main, fleet_file)


def test_the_state_of_axes_of_virtual_axes_comes_from_the_real_ones() -> None:
    outer = {"kind": "rotation", "angle": 30, "of": ["slit.centre", "slit.gap"]}
    plain = table_fleet().to_plain()
    plain["virtual"]["outer"] = outer | {"axes": {"u": {"unit": "mm"}, "v": {"unit": "mm"}}}

    async def main(fleet: VirtualFleet) -> None:
        report, _ = await run_watched(fleet, f"{PREPARE}, {{do: move, to: {{outer.u: 3, outer.v: 1}}}}")
        assert report.state == "done", report.reason
        state = (await fleet.make_client().virtual_states())["outer"]
        assert state.obstacle == "" and state.of == ["front.upper", "front.lower"]
        assert state.axes["u"].position == pytest.approx(3, abs=COUNT_MM)
        assert state.axes["v"].position == pytest.approx(1, abs=COUNT_MM)
        # Both maps are part of what is approved.
        client = fleet.make_client()
        job_id = await client.submit(job("[{do: move, to: {outer.u: 2}}]"), terms=QueueTerms(proposed=True))
        plan = (await client.plan_job(job_id)).plan
        assert plan is not None and {"virtual axes outer", "virtual axes slit"} <= set(plan.parts)

    run_fleet(main, Fleet.model_validate(plain))


# Scans from point to point


def test_virtual_axes_are_scanned_from_point_to_point() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        axes = "{table.pitch: {from: -1 mrad, to: 1 mrad, points: 3}, slit.gap: {values: [2, 4]}}"
        scan = f"{{do: scan, axes: {axes}, at_each: [{{do: dwell, duration: 0.2 s}}]}}"
        dry_run = await client.dry_run(job(f"[{PREPARE}, {{do: move, to: {{slit.centre: 1}}}}, {scan}]"))
        planned = dry_run.steps[-1]
        assert planned.most_s is not None
        report = await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{slit.centre: 1}}}}, {scan}]"))
        assert report.state == "done", report.reason
        step = report.steps[-1]
        assert step.scan is not None and step.scan.points == step.scan.done == 6
        assert step.actual_s is not None and step.actual_s > planned.least_s
        rows = await client.load_points(report.job_id)
        targets = [(row.target["table.pitch"], row.target["slit.gap"]) for row in rows]
        assert targets == [(-1, 2), (-1, 4), (0, 2), (0, 4), (1, 2), (1, 4)]
        for row in rows:
            for name, target in row.target.items():
                assert row.measured[name] == pytest.approx(target, abs=0.01), name
        # What the scan does not name stays.
        _, centre = read_truth(fleet, "slit")
        assert float(centre) == pytest.approx(1, abs=COUNT_MM)

    run_fleet(main, table_fleet())


@pytest.mark.parametrize(
    ("scan", "text"),
    [
        ("axes: {slit.gap: {from: 2, to: 4, points: 3}}, fly: {duration: 20 ms}", "only real axes fly"),
        ("axes: {slit.gap: {from: 2, to: 200, points: 3}}", "soft limits"),
        ("axes: {slit.gap: {values: [2, 4]}, front.upper: {values: [1, 2]}}", "would be moved by"),
        ("axes: {slit.gap: {values: [2 mrad, 4 mrad]}}", "mrad is a unit of angle"),
        ("axes: {slit.gap: {values: [2, 4]}, front.q: {values: [1, 2]}}", "front.q"),
    ],
)
def test_what_a_scan_of_virtual_axes_does_not_allow_is_refused(scan: str, text: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        with pytest.raises(Refusal) as caught:
            await fleet.make_client().submit(job(f"[{PREPARE}, {{do: scan, {scan}}}]"))
        assert text in caught.value.text, caught.value.text

    run_fleet(main, table_fleet())
