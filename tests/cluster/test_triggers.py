"""Outputs that are switched on the way, against the true edges at their terminals."""

import asyncio
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import pytest
from cluster.worlds import PREPARE, changed, demo_fleet, drive_fleet, job, origin_host_ns, run_fleet
from rich.console import Console

from orchestrator.bus.base import BusSample
from orchestrator.client.api import Tutti
from orchestrator.client.steps import JobFailed
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.operation.recording import RecordedTriggers
from orchestrator.model.report import JobReport, TriggerRow
from orchestrator.monitor.export.files import write_tables
from orchestrator.monitor.export.recorded import RecordedRun
from orchestrator.monitor.export.triggers import make_triggers_table
from orchestrator.monitor.report_table import make_report_tables
from orchestrator.runtime.simulated_fleets import make_smc2000, make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.cia402.unit import SimulatedDrive

SETTLED_S = 60.0  # after this time the clocks of controllers are known as well as they ever are
LAMP = "output: gantry.lamp"
CIRCLE = "{do: path, axes: [gantry.x, gantry.y], start: [0, 20], tolerance: 0.2, speed: 50 mm/s, pieces: [{piece: arc, to: [0, 20], centre: [20, 20]}]"


@dataclass
class TrueEdges:
    """The edges at the terminal of an output, fleet time, with the positions of axes there. number: of the output; None:
    the controller switches only one."""

    virtual: VirtualFleet
    controller: str = "gantry"
    motors: tuple[tuple[str, str, str], ...] = (("gantry.x", "gantry", "X"),)
    number: int | None = None
    edges: list[tuple[int, bool]] = field(default_factory=list[tuple[int, bool]])
    places: list[dict[str, float]] = field(default_factory=list[dict[str, float]])

    def __post_init__(self) -> None:
        self.virtual.controllers[self.controller].on_output(self._note)

    def _note(self, number: int, level: bool) -> None:
        if self.number not in (None, number):
            return
        self.edges.append((self.virtual.clock.now_ns() - origin_host_ns(self.virtual), level))
        units = self.virtual.fleet
        self.places.append(
            {
                name: units.axis(name).to_unit(self.virtual.controllers[controller].position(motor))
                for name, controller, motor in self.motors
            }
        )

    def rises(self) -> list[int]:
        """The instants at which it became active."""
        return [at_ns for at_ns, level in self.edges if level]

    def forget(self) -> None:
        """Forget the edges so far."""
        self.edges.clear()
        self.places.clear()


async def run_prepared(virtual: VirtualFleet, wait_s: float = 0.0) -> Tutti:
    """A client, once all axes are enabled and homed."""
    client = virtual.make_client("operator")
    await client.run(PREPARE)
    await sleep_ns(virtual.clock, round(wait_s * 1e9))
    return client


async def run_job(client: Tutti, asked: Job) -> tuple[JobReport, list[TriggerRow]]:
    """Run a job, and return its report with all rows of its triggers, also of one that fails."""
    rows: list[TriggerRow] = []

    def take(sample: BusSample) -> None:
        rows.extend(RecordedTriggers.model_validate_json(sample.payload).rows)

    subscription = await client.bus.subscribe(client.keys.job_triggers(), take)
    try:
        report = await client.run(asked)
    except JobFailed as failed:
        report = failed.report
    await asyncio.sleep(0.1)
    await subscription.undeclare()
    return report, rows


def check_rows(rows: list[TriggerRow], edges: list[int]) -> None:
    """Every true edge is inside the interval of its row, by promise and by evidence."""
    assert len(rows) == len(edges)
    for row, at_ns in zip(rows, edges, strict=True):
        assert row.seen is not None
        assert row.seen.earliest_ns <= at_ns <= row.seen.latest_ns, row
        assert row.earliest_ns <= at_ns <= row.latest_ns, (row, at_ns)


def moved(triggers: str, to: str = "gantry.x: 20", more: str = "", skew: str = "60 ms") -> Job:
    return job(f"[{{do: move, to: {{{to}}}, {more} triggers: [{triggers}]}}]", max_start_skew=skew)


def test_pulses_in_time_are_where_promised_and_where_the_evidence_says() -> None:
    async def main(virtual: VirtualFleet) -> None:
        true = TrueEdges(virtual)
        client = await run_prepared(virtual, SETTLED_S)
        true.forget()
        report, rows = await run_job(client, moved(f"{{{LAMP}, every: 10 ms}}"))
        (step,) = report.steps
        assert step.verdict == "green" and step.t0_fleet_ns is not None
        (triggered,) = step.triggers
        assert (triggered.planned, triggered.seen, triggered.outside) == (28, 28, 0)
        assert triggered.widest_ns <= 2.5 * NS_PER_MS and len(triggered.rows) == 20
        check_rows(rows, true.rises())
        assert [row.planned_ns - step.t0_fleet_ns for row in rows] == [k * 10 * NS_PER_MS for k in range(1, 29)]
        # Each pulse has ended by itself, and the axis truly was where its row says.
        assert [level for _, level in true.edges] == [True, False] * 28
        assert all(
            1 <= (off - on) / NS_PER_MS <= 4
            for (on, _), (off, _) in zip(true.edges[::2], true.edges[1::2], strict=True)
        )
        for row, place in zip(rows, true.places[::2], strict=True):
            x = row.positions["gantry.x"]
            assert x.least <= place["gantry.x"] <= x.most and x.most - x.least < 0.85

    run_fleet(main)


def test_pulses_at_positions_come_on_the_way_there_and_back() -> None:
    async def main(virtual: VirtualFleet) -> None:
        true = TrueEdges(virtual)
        client = await run_prepared(virtual)
        true.forget()
        report, rows = await run_job(client, moved(f"{{{LAMP}, every: 0.1 mm, of: gantry.x}}", more="speed: 0.05,"))
        assert report.steps[0].verdict == "green" and len(rows) == 200
        check_rows(rows, true.rises())
        for number, place in enumerate(true.places[::2], 1):
            assert place["gantry.x"] == pytest.approx(0.1 * number, abs=0.03)
        true.forget()
        # Back, at named positions, as levels: on at the first, off at the second, and off after the end.
        at = f"{{{LAMP}, at: [15, 1 cm, '5000 um'], of: gantry.x, level: true}}"
        report, rows = await run_job(client, moved(at, to="gantry.x: 0, gantry.y: 30", more="speed: 0.05,"))
        assert report.steps[0].verdict == "green"
        check_rows(rows, [at_ns for at_ns, _ in true.edges[:3]])
        assert [level for _, level in true.edges] == [True, False, True, False]
        assert [round(place["gantry.x"], 1) for place in true.places[:3]] == [15.0, 10.0, 5.0]
        assert set(rows[0].positions) == {"gantry.x", "gantry.y"}

    run_fleet(main)


def test_the_controller_of_the_output_need_not_move() -> None:
    async def main(virtual: VirtualFleet) -> None:
        true = TrueEdges(virtual, motors=(("stage.u", "stage", "1"),))
        client = await run_prepared(virtual)
        true.forget()
        asked = moved(f"{{{LAMP}, every: 0.25 mm, of: stage.u, pulse: 20 ms}}", to="stage.u: 2", more="speed: 0.1,")
        report, rows = await run_job(client, asked)
        (step,) = report.steps
        assert step.verdict in ("green", "amber", "none") and not step.deviations and len(rows) == 8
        check_rows(rows, true.rises())
        for row, place in zip(rows, true.places[::2], strict=True):
            assert row.positions["stage.u"].least <= place["stage.u"] <= row.positions["stage.u"].most
        # Nothing is left: the next job switches the output by itself, and moves.
        true.forget()
        await client.run(job(f"[{{do: output, {LAMP}, value: true}}, {{do: move, to: {{gantry.x: 1}}}}]"))
        assert [level for _, level in true.edges] == [True]

    run_fleet(main)


def test_pulses_along_a_contour_are_where_promised() -> None:
    async def main(virtual: VirtualFleet) -> None:
        true = TrueEdges(virtual, motors=(("gantry.x", "gantry", "X"), ("gantry.y", "gantry", "Y")))
        client = await run_prepared(virtual, SETTLED_S)
        await client.run(job("[{do: move, to: {gantry.y: 20}}]"))
        true.forget()
        # X passes each position twice on the circle.
        asked = f"[{CIRCLE}, triggers: [{{{LAMP}, every: 2 mm, of: gantry.x}}]}}]"
        report, rows = await run_job(client, job(asked))
        (step,) = report.steps
        assert step.state == "done" and not step.deviations and len(rows) == 40
        check_rows(rows, true.rises())
        assert max(row.seen.latest_ns - row.seen.earliest_ns for row in rows if row.seen) <= 2.5 * NS_PER_MS
        for row, place in zip(rows, true.places[::2], strict=True):
            for axis, truly in place.items():
                assert row.positions[axis].least <= truly <= row.positions[axis].most, (row, place)

    run_fleet(main)


@pytest.mark.parametrize("way", ["stop", "estop", "abort", "limit", "link", "host", "coordinator"])
def test_nothing_pulses_after_an_end_of_any_kind(way: str) -> None:
    async def main(virtual: VirtualFleet) -> None:
        true = TrueEdges(virtual)
        client = await run_prepared(virtual)
        true.forget()
        asked = moved(f"{{{LAMP}, every: 20 ms, pulse: 5 ms}}", to="gantry.x: 200", more="speed: 0.2,")
        running = asyncio.ensure_future(run_job(client, asked))
        while len(true.rises()) < 20:
            await sleep_ns(virtual.clock, NS_PER_MS)
        await _break_off(virtual, client, way)
        # Without a coordinator the adapter stops it, and without an adapter its own watchdog.
        alone = way in ("link", "host", "coordinator")
        await sleep_ns(virtual.clock, (2500 if alone else 150) * NS_PER_MS)
        count = len(true.edges)
        assert not true.edges[-1][1] and count < (400 if alone else 70)
        await sleep_ns(virtual.clock, 5000 * NS_PER_MS)
        assert len(true.edges) == count, "the output is switched after the end"
        if way == "limit":
            report, rows = await running
            (step,) = report.steps
            assert step.state != "done" and step.triggers[0].seen < step.triggers[0].planned
            seen = [row for row in rows if row.seen is not None]
            # What is claimed has happened; of at most one edge nothing is known.
            assert len(true.rises()) - 1 <= len(seen) <= len(true.rises())
            assert not any(row.positions for row in rows)
            check_rows(seen, true.rises()[: len(seen)])
        running.cancel()

    run_fleet(main)


@pytest.mark.parametrize("way", ["limit", "cancel", "estop", "link", "coordinator"])
def test_an_output_of_a_controller_that_does_not_move_ends_with_the_step(way: str) -> None:
    async def main(virtual: VirtualFleet) -> None:
        true = TrueEdges(virtual, motors=())
        client = await run_prepared(virtual)
        true.forget()
        asked = moved(f"{{{LAMP}, every: 20 ms, pulse: 5 ms}}", to="stage.u: 40", more="speed: 0.5,")
        submitted = await client.submit(asked)
        while len(true.rises()) < 20:
            await sleep_ns(virtual.clock, NS_PER_MS)
        if way == "limit":
            virtual.act_on_controller("stage", lambda unit: unit.set_limit("1", "forward"))
        elif way == "cancel":
            await submitted.cancel()
        else:
            await _break_off(virtual, client, way)
        await sleep_ns(virtual.clock, 2500 * NS_PER_MS)
        count = len(true.edges)
        assert not true.edges[-1][1] and count < (400 if way in ("link", "coordinator") else 90)
        await sleep_ns(virtual.clock, 5000 * NS_PER_MS)
        assert len(true.edges) == count

    run_fleet(main)


async def _break_off(virtual: VirtualFleet, client: Tutti, way: str) -> None:
    if way in ("stop", "abort"):
        await client.stop(mode="abort" if way == "abort" else "decelerate")
    elif way == "estop":
        await client.estop("test")
    elif way == "limit":
        virtual.act_on_controller("gantry", lambda unit: unit.set_limit("X", "forward"))
    elif way == "link":
        wire = virtual.wires["gantry"]
        wire.cut = wire.refuse = True
    elif way == "host":
        virtual.freeze("host/" + virtual.fleet.controllers["gantry"].host)
    else:
        virtual.kill("coordinator/first")


def test_a_step_that_is_held_does_not_go_on() -> None:
    async def main(virtual: VirtualFleet) -> None:
        true = TrueEdges(virtual)
        client = await run_prepared(virtual)
        true.forget()
        asked = moved(f"{{{LAMP}, every: 20 ms}}", to="gantry.x: 100", more="speed: 0.2,")
        submitted = await client.submit(asked)
        while len(true.rises()) < 5:
            await sleep_ns(virtual.clock, NS_PER_MS)
        await submitted.pause(now=True)
        await sleep_ns(virtual.clock, 500 * NS_PER_MS)
        count = len(true.edges)
        await submitted.resume()
        report = await submitted.result()
        assert report.state == "failed"
        assert "cannot be continued after a feed hold" in report.reason
        assert len(true.edges) == count

    run_fleet(main)


@pytest.mark.parametrize(
    ("triggers", "to", "code", "words"),
    [
        ("{output: gantry.lamp, every: 2 ms}", "gantry.x: 20", "trigger-rate", "write at least"),
        ("{output: gantry.lamp, every: 0.1 mm, of: gantry.x}", "gantry.x: 20", "trigger-rate", "move slower"),
        ("{output: stage.shutter, every: 50 ms}", "gantry.x: 20", "no-triggers", "SMC-4000"),
        (
            "{output: gantry.lamp, every: 50 ms}, {output: gantry.other, every: 50 ms}",
            "gantry.x: 20",
            "trigger-many",
            "one",
        ),
        ("{output: gantry.lamp, at: [300], of: gantry.x}", "gantry.x: 20", "trigger-position", "not on the way"),
        ("{output: gantry.lamp, at: [0], of: gantry.x}", "gantry.x: 20", "trigger-position", "start excluded"),
        ("{output: gantry.lamp, at: [5 s]}", "gantry.x: 20", "trigger-late", "after the end"),
        ("{output: gantry.lamp, every: 5 s}", "gantry.x: 20", "trigger-never", "over before"),
        ("{output: gantry.lamp, every: 1 deg, of: gantry.x}", "gantry.x: 20", "bad-unit", "unit of angle"),
        ("{output: gantry.lamb, every: 50 ms}", "gantry.x: 20", "unknown-name", "lamp"),
        ("{output: gantry.lamp, every: 50 ms}", "gantry.x: 20, stage.u: 1", "", ""),
    ],
)
def test_a_trigger_that_cannot_be_is_refused_before_anything_moves(
    triggers: str, to: str, code: str, words: str
) -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = await run_prepared(virtual)
        try:
            await client.run(moved(triggers, to))
        except JobFailed as failed:
            (step,) = failed.report.steps
            assert step.refused is not None and step.refused.code == code
            assert words in f"{step.refused.text} {step.refused.remedy}" and step.t0_fleet_ns is None
        except Refusal as refused:
            assert refused.code == code and words in f"{refused} {refused.remedy}"
        else:
            assert not code

    run_fleet(main, with_outputs())


def with_outputs() -> Fleet:
    fleet = demo_fleet()
    outputs = {"lamp": {"number": 1}, "other": {"number": 2}}
    return changed(fleet, gantry={"outputs": outputs}, stage={"outputs": {"shutter": {"number": 1}}})


def test_an_output_that_is_wired_has_no_triggers() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = await run_prepared(virtual)
        with pytest.raises(Refusal, match=r"wired to stage\.start.* as a trigger line"):
            await client.run(moved("{output: gantry.other, every: 50 ms}"))

    plain = changed(with_outputs(), stage={"inputs": {"start": {"number": 1}}}).to_plain()
    plain["wiring"] = [{"from": "gantry.other", "to": ["stage.start"]}]
    run_fleet(main, Fleet.model_validate(plain))


def test_all_rows_are_in_the_recording_and_its_tables(tmp_path: Path) -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = await run_prepared(virtual)
        report, rows = await run_job(client, moved(f"{{{LAMP}, every: 10 ms}}"))
        run = RecordedRun(report=report)
        step = report.steps[0]
        run.triggers.append(RecordedTriggers(job_id=report.job_id, step=0, output="gantry.lamp", rows=rows))
        table = make_triggers_table(run)
        assert table.row_count == 28 and list(table.columns)[-2:] == ["gantry.x.lo", "gantry.x.hi"]
        assert step.t0_fleet_ns is not None and table.columns["planned_ns"][0] == step.t0_fleet_ns + 10 * NS_PER_MS
        shown = StringIO()
        Console(file=shown, width=140).print(make_report_tables(report, detailed=True))
        assert "gantry.lamp: 28 of 28 triggers seen, each within" in shown.getvalue()
        write_tables([table], tmp_path / "t.csv", "csv")
        assert (tmp_path / "t.csv").read_text().count("\n") == 29

    run_fleet(main)


# Latches


def with_probe(active: str = "low", number: int = 1) -> Fleet:
    return changed(demo_fleet(), gantry={"inputs": {"probe": {"number": number, "active": active}}})


LATCH = "{do: latch, axis: gantry.x, input: gantry.probe, timeout: 5 s}"


def test_a_latch_reports_where_the_axis_was_at_the_edge() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = await run_prepared(virtual)
        asked = job(f"[{{do: move, to: {{gantry.x: 12.5}}}}, {{do: set-position, axes: {{gantry.x: 2.5}}}}, {LATCH}]")
        submitted = await client.submit(asked)
        await sleep_ns(virtual.clock, 3000 * NS_PER_MS)
        edge_ns = virtual.clock.now_ns() - origin_host_ns(virtual)
        virtual.act_on_controller("gantry", lambda unit: unit.set_input(1, level=False))
        report = await submitted.result()
        latched = report.steps[2].latch
        assert report.state == "done" and latched is not None
        assert (latched.position, latched.counts, latched.unit) == (2.5, 12_500, "mm")
        assert latched.seen.earliest_ns <= edge_ns + 25_000 <= latched.seen.latest_ns
        assert latched.seen.latest_ns - latched.seen.earliest_ns < 40 * NS_PER_MS

    run_fleet(main, with_probe())


@pytest.mark.parametrize(
    ("fleet", "step", "code", "words"),
    [
        (with_probe(), LATCH, "latch-timeout", "captured nothing within 5 s"),
        (with_probe(number=2), LATCH, "latch-input", "input 1 does"),
        (with_probe("high"), LATCH, "latch-input", "falling edge"),
        (
            changed(demo_fleet(), stage={"inputs": {"probe": {"number": 1}}}),
            "{do: latch, axis: stage.u, input: stage.probe, timeout: 1 s}",
            "no-latch",
            "this make has no position latch",
        ),
    ],
)
def test_what_cannot_latch_is_refused(fleet: Fleet, step: str, code: str, words: str) -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = await run_prepared(virtual)
        with pytest.raises(JobFailed) as failed:
            await client.run(job(f"[{step}]"))
        (refused,) = [each.refused for each in failed.value.report.steps]
        assert refused is not None and refused.code == code and words in refused.text

    run_fleet(main, fleet)


def test_a_stop_ends_an_armed_latch() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = await run_prepared(virtual)
        submitted = await client.submit(job(f"[{LATCH}]"))
        await sleep_ns(virtual.clock, 1000 * NS_PER_MS)
        began_ns = virtual.clock.now_ns()
        await client.stop()
        report = await submitted.result()
        assert report.state in ("aborted", "failed") and virtual.clock.now_ns() - began_ns < 1000 * NS_PER_MS

    run_fleet(main, with_probe())


# Latches of CiA 402 drives


PROBE = "{do: latch, axis: lift.z, input: lift.probe, timeout: 5 s}"


@pytest.mark.parametrize("active", ["high", "low"])
def test_a_touch_probe_reports_where_the_drive_was_at_the_edge(active: str) -> None:
    async def main(virtual: VirtualFleet) -> None:
        virtual.act_on_controller("lift", lambda unit: unit.set_input(2, level=active == "low"))
        client, drive = virtual.make_client("operator"), virtual.controllers["lift"]
        assert isinstance(drive, SimulatedDrive)
        prepare = "{do: enable, axes: [lift]}, {do: home, axes: [lift.z]}, {do: move, to: {lift.z: 12.5}}"
        submitted = await client.submit(job(f"[{prepare}, {{do: set-position, axes: {{lift.z: 2.5}}}}, {PROBE}]"))
        while drive.position("1") != 12_500:
            await sleep_ns(virtual.clock, 50 * NS_PER_MS)
        await sleep_ns(virtual.clock, 1000 * NS_PER_MS)
        edge_ns = virtual.clock.now_ns() - origin_host_ns(virtual)
        # The probe bounces: its first edge counts.
        for level in (True, False, True):
            virtual.act_on_controller("lift", lambda unit, to=level: unit.set_input(2, level=to == (active == "high")))
        report = await submitted.result()
        latched = report.steps[-1].latch
        assert report.state == "done" and latched is not None, report.reason
        assert (latched.position, latched.counts, latched.unit) == (2.5, 12_500, "mm")
        assert latched.seen.earliest_ns <= edge_ns <= latched.seen.latest_ns
        assert latched.seen.latest_ns - latched.seen.earliest_ns < 30 * NS_PER_MS
        assert drive.station.dictionary.get_value(0x60B8) == 0  # it is off again

    run_fleet(main, drive_fleet("probe", active))


@pytest.mark.parametrize(
    ("fleet", "code", "words"),
    [
        (drive_fleet("probe"), "latch-timeout", "captured nothing within 5 s"),
        (drive_fleet("probe", "low"), "line-level", "active already"),
        (drive_fleet("probe", number=3), "latch-input", "input 1 and input 2"),
        (drive_fleet("probe", probe_inputs=(1,)), "latch-input", "touch probe 2"),
        (drive_fleet("probe", without=("60B8", "60B9")), "no-latch", "no touch probe"),
    ],
)
def test_what_a_drive_cannot_latch_is_refused(fleet: Fleet, code: str, words: str) -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = virtual.make_client("operator")
        with pytest.raises(JobFailed) as failed:
            await client.run(job(f"[{{do: enable, axes: [lift]}}, {{do: home, axes: [lift.z]}}, {PROBE}]"))
        refused = failed.value.report.steps[-1].refused
        assert refused is not None and refused.code == code and words in refused.text

    run_fleet(main, fleet)


@pytest.mark.parametrize("way", ["stop", "other", "restart"])
def test_a_touch_probe_that_is_broken_off_reports_nothing(way: str) -> None:
    async def main(virtual: VirtualFleet) -> None:
        client, drive = virtual.make_client("operator"), virtual.controllers["lift"]
        assert isinstance(drive, SimulatedDrive)
        await client.run(job("[{do: enable, axes: [lift]}, {do: home, axes: [lift.z]}]"))
        submitted = await client.submit(job(f"[{PROBE}]"))
        await sleep_ns(virtual.clock, 1000 * NS_PER_MS)
        began_ns = virtual.clock.now_ns()
        if way == "stop":
            await client.stop()
        elif way == "other":
            drive.station.dictionary.accept_value(0x60B8, 0, 0)
        else:
            virtual.act_on_controller("lift", lambda unit: unit.set_power(on=False))
            virtual.act_on_controller("lift", lambda unit: unit.set_power(on=True))
        report = await submitted.result()
        assert report.state in ("aborted", "failed") and virtual.clock.now_ns() - began_ns < 1500 * NS_PER_MS
        assert not any(step.latch for step in report.steps)

    run_fleet(main, drive_fleet("probe"))


# The SMC-2000, on a serial line


def with_press(address: int | None = None, limits: dict[str, float] | None = None) -> Fleet:
    press = make_smc2000(0, address)
    axis = {**press["axes"]["x"], "limits": {"velocity": 200, "acceleration": 1000, **(limits or {})}}
    press = {**press, "axes": {"x": axis}, "outputs": {"lamp": {"number": 1}}}
    gantry = make_smc4000(0)
    controllers = {"press": press, "gantry": gantry}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "press", "controllers": controllers})


async def run_press(virtual: VirtualFleet, wait_s: float = 0.0) -> tuple[Tutti, TrueEdges]:
    """A client, once both axes are homed, and the true edges of the press from then on."""
    client, true = virtual.make_client("operator"), TrueEdges(virtual, "press", (("press.x", "press", "X"),))
    await client.run(job("[{do: enable, axes: [press, gantry]}, {do: home}]"))
    await sleep_ns(virtual.clock, round(wait_s * 1e9))
    true.forget()
    return client, true


PRESS = "output: press.lamp"


@pytest.mark.parametrize("limits", [{}, {"jerk": 20_000}], ids=["move", "contour"])
def test_an_smc_2000_pulses_where_promised(limits: dict[str, float]) -> None:
    async def main(virtual: VirtualFleet) -> None:
        client, true = await run_press(virtual, 30)
        for triggers, to, count in (
            (f"{{{PRESS}, every: 60 ms}}", "press.x: 100", 30),
            (f"{{{PRESS}, every: 5 mm, of: press.x, level: true}}", "press.x: 0", 20),
            (f"{{{PRESS}, every: 5 mm, of: gantry.x, pulse: 10 ms}}", "gantry.x: 40", 8),
        ):
            report, rows = await run_job(client, moved(triggers, to, more="speed: 0.25,"))
            (step,) = report.steps
            assert report.state == "done" and not step.deviations, (report.reason, step.deviations)
            edges = true.rises() if "level" not in triggers else [at_ns for at_ns, _ in true.edges[:count]]
            assert len(rows) >= count
            check_rows(rows, edges)
            assert not true.edges[-1][1]
            for row, place in zip(rows, true.places[:: 1 if "level" in triggers else 2], strict=False):
                if "press.x" in row.positions:
                    x = row.positions["press.x"]
                    assert x.least <= place["press.x"] <= x.most
            true.forget()

    run_fleet(main, with_press(limits=limits))


@pytest.mark.parametrize("way", ["stop", "estop", "limit", "link", "coordinator"])
def test_nothing_pulses_after_an_end_of_a_step_of_an_smc_2000(way: str) -> None:
    async def main(virtual: VirtualFleet) -> None:
        client, true = await run_press(virtual)
        asked = moved(f"{{{PRESS}, every: 60 ms, pulse: 30 ms}}", "press.x: 200", more="speed: 0.1,")
        running = asyncio.ensure_future(run_job(client, asked))
        while len(true.rises()) < 10:
            await sleep_ns(virtual.clock, NS_PER_MS)
        if way == "limit":
            virtual.act_on_controller("press", lambda unit: unit.set_limit("X", "forward"))
        elif way == "link":
            wire = virtual.wires["press"]
            wire.cut = wire.refuse = True
        else:
            await _break_off(virtual, client, way)
        await sleep_ns(virtual.clock, 3000 * NS_PER_MS)
        count = len(true.edges)
        assert not true.edges[-1][1] and count < 120
        await sleep_ns(virtual.clock, 5000 * NS_PER_MS)
        assert len(true.edges) == count and not virtual.controllers["press"].is_moving("X")
        running.cancel()

    run_fleet(main, with_press())


def test_an_smc_2000_on_a_chain_has_no_triggers() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client, _ = await run_press(virtual)
        with pytest.raises((JobFailed, Refusal)) as failed:
            await client.run(moved(f"{{{PRESS}, every: 60 ms}}", "press.x: 10"))
        assert "daisy chain has no triggers" in str(failed.value)

    run_fleet(main, with_press(address=0))
