"""Statistics of a seeded run against what the simulated controllers did; kept over pruning and a restart."""

from typing import Any

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from orchestrator.bus.base import RequestRefused
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.operation.statistics import AxisFigures, PeriodFigures
from orchestrator.runtime.virtual.fleet import VirtualFleet

DAY = "2026-01-01"
TO = [(20, 3), (5, 4), (30, 1), (10, 2)]
MOVES = job("[" + ", ".join(f"{{do: move, to: {{gantry.x: {x}, stage.u: {u}}}, speed: 0.5}}" for x, u in TO) + "]")


async def read(client: Tutti, since: str = DAY) -> PeriodFigures:
    return (await client.read_statistics(since)).total


def axis(figures: PeriodFigures, name: str) -> AxisFigures:
    return next(each for each in figures.axes if each.axis == name)


def true_moves(fleet: VirtualFleet, controller: str, motor: str, after_ns: int) -> list[Any]:
    made = fleet.controllers[controller].commanded_motions
    return [each for each in made if each.axis == motor and each.start_ns >= after_ns]


def test_figures_are_those_of_the_true_motions_and_outlive_jobs_and_coordinators() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        begun_ns = fleet.clock.now_ns()
        reports = [await outcome(fleet, MOVES), await outcome(fleet, job("[{do: dwell, duration: 1 ms}]"))]
        figures = await read(client)
        x, u = axis(figures, "gantry.x"), axis(figures, "stage.u")
        for found, controller, motor, name in ((x, "gantry", "X", "x"), (u, "stage", "1", "u")):
            true = true_moves(fleet, controller, motor, begun_ns)
            config = demo_fleet().controllers[controller].axes[name]
            way = sum(abs(config.to_unit(each.end_counts - each.start_counts)) for each in true)
            assert (found.moves, found.unit) == (4, config.unit) and len(true) == 4
            assert found.distance == pytest.approx(way, rel=1e-3)
            took_s = sum(each.end_ns - each.start_ns for each in true) / NS_PER_S
            assert found.moving_s == pytest.approx(took_s, rel=0.05)
        assert (x.reversals, u.reversals) == (3, 2)
        assert (figures.jobs, figures.failures) == ({"done": 3}, {})
        (pair,) = figures.pairs
        skews = [each.narrowest_skew for each in reports[0].steps]
        bounds = [each.at_most_ns for each in skews if each is not None]
        assert (pair.pair, pair.moves, pair.worst_ns) == (("gantry", "stage"), 4, max(bounds))
        assert pair.mean_ns == pytest.approx(sum(bounds) / 4, abs=1)
        assert sorted(bounds)[1] <= pair.p50_ns <= sorted(bounds)[1] * 1.021 and pair.p99_ns <= max(bounds)
        # Jobs are deleted, and the coordinator is killed: the figures stay.
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        assert await client.prune_jobs(0, 0) == 3 and (await client.list_jobs()).total == 0
        fleet.kill("coordinator/first")
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        fleet.start_coordinator("second")
        await sleep_ns(fleet.clock, 3 * NS_PER_S)
        again = await read(client)
        assert (again.axes, again.pairs, again.jobs) == (figures.axes, figures.pairs, figures.jobs)
        assert (await read(client, "2026-01-02")).axes == []

    run_fleet(main)


def test_moves_that_are_stopped_and_jogs_count_by_readings_and_failures_by_cause() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        job_id = await client.submit(job("[{do: move, to: {gantry.x: 100}, speed: 0.1}]"))
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        await client.cancel_job(job_id)
        await client.wait_for_job(job_id)
        stood = (await client.status())["gantry"].axes["x"].position
        await client.start_queue()
        async with client.manual_control(["gantry.x"]) as control:
            await control.jog({"gantry.x": 5.0})
            for _ in range(10):
                await sleep_ns(fleet.clock, NS_PER_S // 10)
                await control.renew_jog()
            await control.stop()
        await sleep_ns(fleet.clock, NS_PER_S)
        end = (await client.status())["gantry"].axes["x"].position
        assert end - stood > 3
        fleet.wires["stage"].cut = True
        report = await outcome(fleet, job("[{do: enable, axes: [stage]}]"))
        assert report.state == "failed"
        found = await read(client)
        x = axis(found, "gantry.x")
        assert x.moves == 1 and 0 < x.distance <= end and x.distance == pytest.approx(end, rel=0.1)
        assert x.moving_s == pytest.approx(3, abs=0.6)
        assert found.jobs == {"done": 1, "cancelled": 1, "failed": 1} and sum(found.failures.values()) == 1

    run_fleet(main)


def test_availability_is_the_time_in_each_state_day_by_day() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        begun_ns = fleet.clock.now_ns()
        await sleep_ns(fleet.clock, 20 * NS_PER_S)
        fleet.wires["stage"].cut = True
        await sleep_ns(fleet.clock, 30 * NS_PER_S)
        fleet.wires["stage"].cut = False
        await sleep_ns(fleet.clock, 20 * NS_PER_S)
        fleet.clock.wall_step_ns = 24 * 3600 * NS_PER_S
        await sleep_ns(fleet.clock, 10 * NS_PER_S)
        read = await client.read_statistics(DAY, by_day=True)
        gantry, stage = read.total.controllers
        whole_s = (fleet.clock.now_ns() - begun_ns) / NS_PER_S
        assert gantry.online_s == pytest.approx(whole_s, abs=0.5) and gantry.availability == 1
        assert stage.offline_s == pytest.approx(30, abs=4) and stage.faults == {"no-answer": 1}
        assert stage.online_s + stage.offline_s + stage.fault_s == pytest.approx(whole_s, abs=0.5)
        assert [each.day for each in read.days] == [DAY, "2026-01-02"]
        assert read.days[1].controllers[0].online_s == pytest.approx(10, abs=1.1)
        with pytest.raises(RequestRefused, match="since: String should match pattern"):
            await client.bus.request(
                client.keys.service("statistics"), b'{"request_id": "1", "actor": "a", "since": "yesterday"}', 1.0
            )

    run_fleet(main)
