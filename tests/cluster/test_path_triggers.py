"""Outputs that are switched on the way of long paths, chunk after chunk, against the true edges at their terminals."""

import asyncio
from dataclasses import dataclass, field

import pytest
from cluster.test_paths import ALONE, TWO, begin, circle, delay_chunks, gantries, gantry_and_drive, is_moving, prepare
from cluster.test_triggers import TrueEdges, check_rows
from cluster.worlds import changed, outcome, run_fleet

from orchestrator.bus.base import BusSample
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.operation.recording import RecordedTriggers
from orchestrator.model.report import JobReport, TriggerRow
from orchestrator.runtime.virtual.fleet import VirtualFleet

COUNT, TWO_TURNS = 400, 798  # in two turns the fitted path turns back some micrometres before the outermost places
DRIVEN = ("gantry.x", "drive.y")


@dataclass
class Switched:
    """A fleet with an output, and a path that switches it each half millimetre of an axis, 40 times a second at most."""

    fleet: Fleet
    axes: tuple[str, str]
    output: str
    of: str
    pulse: str = "1 ms"
    speed: str = "20 mm/s"
    turns: int = 1
    rows: list[TriggerRow] = field(default_factory=list[TriggerRow])

    @property
    def path(self) -> Job:
        trigger = f"{{output: {self.output}, every: 0.5 mm, of: {self.of}, pulse: {self.pulse}}}"
        return circle(self.axes, self.turns, speed=self.speed, triggers=f"[{trigger}]")

    async def prepare(self, virtual: VirtualFleet) -> TrueEdges:
        """Home, go to the start, let the clocks settle; the true edges from then on, and all rows."""
        prepared = await outcome(virtual, prepare(virtual.fleet, self.axes))
        assert prepared.state == "done", prepared.reason
        client = virtual.make_client()
        await client.bus.subscribe(client.keys.job_triggers(), self._take)
        await sleep_ns(virtual.clock, 30 * NS_PER_S)
        controller = self.of.partition(".")[0]
        motor = virtual.fleet.axis(self.of).motors[0]
        true = TrueEdges(virtual, self.output.partition(".")[0], ((self.of, controller, motor),))
        true.forget()
        return true

    def _take(self, sample: BusSample) -> None:
        self.rows.extend(RecordedTriggers.model_validate_json(sample.payload).rows)

    def check_seen(self, true: TrueEdges) -> None:
        """Each row that is seen has happened, once, as promised and at its place; and nothing else has."""
        assert [row.number for row in self.rows] == list(range(1, len(self.rows) + 1))
        check_rows([row for row in self.rows if row.seen is not None], true.rises())


def driven() -> Switched:
    """A drive that switches an output with its own positions, while a gantry has the other axis."""
    fleet = changed(gantry_and_drive(), drive={"outputs": {"lamp": {"number": 1}}})
    return Switched(fleet, DRIVEN, "drive.lamp", "gantry.x", pulse="10 ms")


def with_lamp(owner: str, axes: tuple[str, str]) -> Switched:
    """Two SMC-4000, of which one has an output."""
    return Switched(
        changed(gantries(), **{owner: {"outputs": {"lamp": {"number": 1}}}}), axes, f"{owner}.lamp", axes[0]
    )


OWNERS = {
    "drive": driven,
    "gantry": lambda: with_lamp("gantry", TWO),
    "standing": lambda: with_lamp("portal", ALONE),
}


@pytest.fixture
def switched(request: pytest.FixtureRequest) -> Switched:
    return OWNERS[request.param]()


def by_owner(*usual: str) -> pytest.MarkDecorator:
    """Each owner of an output in turn; all but the usual ones nightly."""
    marks = {name: () if name in usual else pytest.mark.nightly for name in OWNERS}
    return pytest.mark.parametrize(
        "switched", [pytest.param(name, marks=mark) for name, mark in marks.items()], indirect=True
    )


async def finish(virtual: VirtualFleet, job_id: str) -> JobReport:
    report = await virtual.make_client().wait_for_job(job_id)
    await asyncio.sleep(0.1)
    return report


@by_owner("drive", "standing")
def test_each_place_of_a_long_path_is_switched_once(switched: Switched) -> None:
    async def main(virtual: VirtualFleet) -> None:
        switched.turns = 2
        true = await switched.prepare(virtual)
        report = await outcome(virtual, switched.path)
        (step,) = report.steps
        assert report.state == "done" and not step.deviations, (report.reason, step.deviations)
        assert step.planned_s is not None and step.planned_s > 30
        (triggered,) = step.triggers
        assert (triggered.planned, triggered.seen, triggered.outside) == (TWO_TURNS, TWO_TURNS, 0) and len(
            triggered.rows
        ) == 20
        switched.check_seen(true)
        for row, place in zip(switched.rows, true.places[::2], strict=True):
            assert row.positions[switched.of].least <= place[switched.of] <= row.positions[switched.of].most
            assert abs(place[switched.of] * 2 - round(place[switched.of] * 2)) < 0.5

    run_fleet(main, switched.fleet)


@by_owner("drive", "gantry")
def test_a_feed_hold_withdraws_triggers_and_they_go_on_behind_it(switched: Switched) -> None:
    async def main(virtual: VirtualFleet) -> None:
        true = await switched.prepare(virtual)
        client = virtual.make_client()
        job_id = await begin(virtual, switched.path, switched.axes, 10.0)
        await client.pause_job(job_id, now=True)
        while is_moving(virtual, switched.axes):
            await sleep_ns(virtual.clock, 10 * NS_PER_MS)
        await sleep_ns(virtual.clock, 500 * NS_PER_MS)
        count = len(true.edges)
        assert not true.edges[-1][1]
        await sleep_ns(virtual.clock, 3 * NS_PER_S)
        assert len(true.edges) == count
        await client.resume_job(job_id)
        report = await finish(virtual, job_id)
        (step,) = report.steps
        assert report.state == "done" and len(step.feed_holds) == 1, report.reason
        (triggered,) = step.triggers
        missed = COUNT - triggered.seen
        assert triggered.planned == COUNT and triggered.outside == 0 and 1 <= missed <= 8
        assert triggered.problem == f"{missed} not played, because the path was being braked there"
        assert step.verdict == "red" and triggered.problem in step.deviations[0]
        switched.check_seen(true)

    run_fleet(main, switched.fleet)


@by_owner("drive")
def test_an_override_moves_the_instants_with_the_path(switched: Switched) -> None:
    async def main(virtual: VirtualFleet) -> None:
        true = await switched.prepare(virtual)
        client = virtual.make_client()
        job_id = await begin(virtual, switched.path, switched.axes, 6.0)
        await client.override_job(job_id, 50)
        await sleep_ns(virtual.clock, 8 * NS_PER_S)
        await client.override_job(job_id, 100)
        report = await finish(virtual, job_id)
        (step,) = report.steps
        assert report.state == "done", report.reason
        assert (step.triggers[0].planned, step.triggers[0].seen, step.triggers[0].outside) == (COUNT, COUNT, 0)
        switched.check_seen(true)
        assert all(abs(place[switched.of] * 2 - round(place[switched.of] * 2)) < 0.5 for place in true.places[::2])

    run_fleet(main, switched.fleet)


def test_an_override_while_a_chunk_is_loaded_takes_its_place() -> None:
    switched = with_lamp("portal", TWO)

    async def main(virtual: VirtualFleet) -> None:
        true = await switched.prepare(virtual)
        client = virtual.make_client()
        # The next chunk is loaded from 3.7 s on, which takes a second.
        job_id = await begin(virtual, switched.path, switched.axes, 4.0)
        await client.override_job(job_id, 120)
        report = await finish(virtual, job_id)
        (step,) = report.steps
        assert report.state == "done" and step.path is not None and not step.path.stops, report.reason
        assert (step.triggers[0].planned, step.triggers[0].seen, step.triggers[0].outside) == (COUNT, COUNT, 0)
        switched.check_seen(true)

    run_fleet(main, switched.fleet)


@pytest.mark.parametrize(("speed", "is_held"), [("35 mm/s", True), ("36.5 mm/s", False)])
def test_triggers_that_are_too_close_for_chunks_are_loaded_as_a_whole(speed: str, is_held: bool) -> None:
    """14 ms from one to the next in chunks, 13.5 as a whole: then there is no hold on the way."""
    switched = with_lamp("gantry", TWO)
    switched.speed = speed

    async def main(virtual: VirtualFleet) -> None:
        true = await switched.prepare(virtual)
        client = virtual.make_client()
        job_id = await begin(virtual, switched.path, switched.axes, 3.0)
        await client.pause_job(job_id, now=is_held)
        await client.resume_job(job_id)
        report = await finish(virtual, job_id)
        (step,) = report.steps
        assert report.state == "done" and bool(step.feed_holds) == is_held, report.reason
        assert step.triggers[0].outside == 0
        switched.check_seen(true)

    run_fleet(main, switched.fleet)


@by_owner("gantry")
def test_a_late_chunk_misses_what_its_tail_passes_and_nothing_twice(
    switched: Switched, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(virtual: VirtualFleet) -> None:
        switched.of = switched.axes[1]  # which is fast where the first chunk ends
        true = await switched.prepare(virtual)
        report = await finish(virtual, await virtual.make_client().submit(switched.path))
        (step,) = report.steps
        assert report.state == "done" and step.path is not None, report.reason
        assert len(step.path.stops) == 1
        (triggered,) = step.triggers
        missing = [row.number for row in switched.rows if row.seen is None]
        assert triggered.outside == 0 and triggered.planned == len(switched.rows)
        assert 1 <= len(missing) == triggered.planned - triggered.seen <= 8 and missing == list(
            range(missing[0], missing[-1] + 1)
        )
        switched.check_seen(true)

    delay_chunks(monkeypatch, "y", 1)
    run_fleet(main, switched.fleet)


@by_owner("standing")
def test_nothing_is_switched_after_an_estop(switched: Switched) -> None:
    async def main(virtual: VirtualFleet) -> None:
        true = await switched.prepare(virtual)
        job_id = await begin(virtual, switched.path, switched.axes, 10.0)
        await virtual.make_client().estop("test")
        await sleep_ns(virtual.clock, 300 * NS_PER_MS)
        count = len(true.edges)
        assert not true.edges[-1][1]
        report = await finish(virtual, job_id)
        await sleep_ns(virtual.clock, 10 * NS_PER_S)
        assert report.state in ("aborted", "failed") and len(true.edges) == count

    run_fleet(main, switched.fleet)
