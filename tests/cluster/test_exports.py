"""Recordings as tables: the numbers of the bus are those of the files."""

import asyncio
import csv
import json
import math
from pathlib import Path
from typing import Any

import h5py
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from cluster.recordings import RecordedFleet
from cluster.worlds import PREPARE, demo_job, job, run_fleet, virtual_demo_fleet

from orchestrator.bus.base import BusSample
from orchestrator.cli.main import main as command
from orchestrator.client.results import JobResult
from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.model.report import JobReport, PointRecord
from orchestrator.model.state import ControllerState
from orchestrator.monitor.export.dataframe import NoDataFrames, make_dataframe
from orchestrator.monitor.export.moves import make_moves_table
from orchestrator.monitor.export.recorded import RecordedRun, load_run
from orchestrator.monitor.export.samples import ExportTooLarge, make_grid_table, make_samples_table
from orchestrator.monitor.recording.reader import Recording
from orchestrator.runtime.virtual.fleet import VirtualFleet

SCAN = job(
    "[{do: scan, axes: {gantry.x: {from: 0, to: 4, points: 3}}, at_each: [{do: dwell, duration: 50 ms}]},"
    " {do: move, to: {stage.u: 2}}]"
)


class Run:
    """One recorded run. published: (axis, read_fleet_ns) → position, as it was on the bus. reports: of its jobs. points:
    of the last one."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.published: dict[tuple[str, int], float] = {}
        self.reports: list[JobReport] = []
        self.points: list[PointRecord] = []
        run_fleet(self._record, virtual_demo_fleet())

    async def _record(self, virtual: VirtualFleet) -> None:
        recorded = RecordedFleet(virtual, self.folder)
        await recorded.recorder.start()
        running = asyncio.ensure_future(recorded.recorder.run())
        tutti = virtual.make_client("anna")
        listener = virtual.net.join_process("listener")
        await listener.subscribe(virtual.keys.state(), self._note)
        await listener.subscribe(virtual.keys.virtual(), self._note_virtual)
        for each in (PREPARE, demo_job(), SCAN):
            self.reports.append(await tutti.wait_for_job(await tutti.submit(each)))
        self.points = await tutti.load_points(self.reports[-1].job_id)
        await asyncio.sleep(4)
        running.cancel()
        await recorded.recorder.close()

    def _note(self, sample: BusSample) -> None:
        state = ControllerState.model_validate_json(sample.payload)
        if state.read_fleet_ns is not None:
            for name, axis in state.axes.items():
                self.published[f"{state.controller}.{name}", state.read_fleet_ns] = axis.position

    def _note_virtual(self, sample: BusSample) -> None:
        state = VirtualState.model_validate_json(sample.payload)
        if state.fleet_ns is not None:
            for name, axis in state.axes.items():
                self.published[f"{state.group}.{name}", state.fleet_ns] = axis.position

    def load(self, number: int) -> RecordedRun:
        """What is recorded of a job, by its number."""
        (path,) = self.folder.glob(f"job-*-{self.reports[number].job_id[:8]}.mcap")
        with Recording(path) as recording:
            return load_run(recording)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return Run(tmp_path_factory.mktemp("recordings"))


def test_samples_are_the_readings_of_the_bus(run: Run) -> None:
    table = make_samples_table(run.load(1))
    columns = table.columns
    rows = list(zip(columns["axis"], columns["fleet_ns"], columns["position"], strict=True))
    assert len(rows) > 100 and len(set(rows)) == len(rows)
    assert all(run.published[axis, at_ns] == position for axis, at_ns, position in rows)
    times = list(columns["fleet_ns"])
    assert times == sorted(times)


def test_virtual_axes_are_in_all_tables_and_marked(run: Run) -> None:
    recorded = run.load(1)
    samples, grid = make_samples_table(recorded).columns, make_grid_table(recorded).columns
    modes = dict(zip(samples["axis"], samples["mode"], strict=True))
    virtual = {axis for axis in modes if axis.startswith("turned.")}
    assert virtual and {axis for axis, mode in modes.items() if mode == "virtual"} == virtual
    for axis in virtual:
        positions = [value for value in grid[f"{axis}.position"] if not math.isnan(value)]
        assert max(positions) - min(positions) > 1
    assert recorded.units["turned.u"] == "mm"


def test_the_grid_has_the_readings_at_their_instants_and_the_plans(run: Run) -> None:
    recorded = run.load(1)
    grid = make_grid_table(recorded, 1_000_000).columns
    first = grid["fleet_ns"][0]
    for axis in ("gantry.x", "stage.u"):
        for reading in recorded.readings[axis]:
            row = (reading.fleet_ns - first) // 1_000_000
            if reading is recorded.readings[axis][0]:
                continue  # the grid's instant before it has no position
            around = [grid[f"{axis}.position"][row], grid[f"{axis}.position"][min(row + 1, len(grid["step"]) - 1)]]
            # Between the grid's two neighbours, as far as a millisecond of motion goes.
            assert min(around) - 0.3 <= reading.position <= max(around) + 0.3
    for plan in recorded.plans:
        for axis, planned in plan.axes.items():
            at = planned.profile.make_evaluator()
            rows = [row for row, step in enumerate(grid["step"]) if step == plan.step][::50]
            for row in rows:
                after_s = (int(grid["fleet_ns"][row]) - plan.t0_fleet_ns) / 1e9
                if after_s > planned.profile.duration_s:
                    continue
                meant = (planned.profile.start_counts + at(after_s).position) / planned.counts_per_unit
                assert grid[f"{axis}.planned"][row] == pytest.approx(meant, abs=1e-9)
    assert set(grid["step"]) == {-1, *(each.step for each in recorded.plans)}


def test_a_gap_between_readings_has_no_position(run: Run) -> None:
    recorded = run.load(1)
    kept = recorded.readings["gantry.x"]
    middle = kept[len(kept) // 2].fleet_ns
    far = RecordedRun({"gantry.x": [kept[0], kept[1], kept[-1]._replace(fleet_ns=middle + 60_000_000_000)]})
    grid = make_grid_table(far, 100_000_000).columns
    positions = list(grid["gantry.x.position"])
    assert not math.isnan(positions[0])
    assert all(math.isnan(each) for each in positions[20:-1])


def test_moves_have_the_intervals_of_the_evidence_and_points_of_scans_have_rows(run: Run) -> None:
    for number in (1, 2):
        report, recorded = run.reports[number], run.load(number)
        assert recorded.report == report
        table = make_moves_table(report, recorded.events)
        rows = [dict(zip(table.columns, row, strict=True)) for row in zip(*table.columns.values(), strict=True)]
        by_step = {(row["step"], row["axis"]): row for row in rows}
        for step in report.steps:
            for name, member in step.members.items():
                for axis, evidence in member.evidence.items():
                    row = by_step[step.index, f"{name}.{axis}"]
                    start, end = evidence.start_for_verdict, evidence.end
                    assert (row["start_t_lo_ns"], row["start_t_hi_ns"]) == (start.earliest_ns, start.latest_ns)
                    assert end is not None and (row["end_t_lo_ns"], row["end_t_hi_ns"]) == (
                        end.earliest_ns,
                        end.latest_ns,
                    )
                    assert row["verdict"] == step.verdict
    # Three points and a move: the first point is where the axis stands already, or is moved to.
    moved = sorted(step for step, axis in by_step if axis == "gantry.x")
    assert len(moved) >= 2 and all(by_step[step, "gantry.x"]["start_t_lo_ns"] for step in moved)


@pytest.mark.parametrize("kind", ["parquet", "csv", "hdf5"])
def test_points_of_scans_are_a_table_of_the_recording(run: Run, tmp_path: Path, kind: str) -> None:
    assert len(run.points) == 3 and run.load(2).points == run.points
    output = tmp_path / f"scan{ {'parquet': '.parquet', 'csv': '.csv', 'hdf5': '.h5'}[kind] }"
    result = CliRunner().invoke(
        command, ["export", "test", "--folder", str(run.folder), "--to", kind, "-o", str(output), "--json"]
    )
    assert result.exit_code == 0, result.output
    assert json.loads(result.output)["rows"]["points"] == 3
    rows = read_table(kind, output, "points")
    assert [int(row["point"]) for row in rows] == [1, 2, 3]
    assert [float(row["gantry.x target"]) for row in rows] == [0, 2, 4]
    assert [row["verdict"] for row in rows] == [point.verdict for point in run.points]
    if kind == "hdf5":
        with h5py.File(output) as file:
            opened: Any = file
            assert opened["points/gantry.x measured"].attrs["units"] == "mm"


@pytest.mark.parametrize("kind", ["parquet", "csv", "hdf5"])
def test_files_have_the_numbers_of_the_bus_with_units_and_verdicts(run: Run, tmp_path: Path, kind: str) -> None:
    output = tmp_path / f"demo{ {'parquet': '.parquet', 'csv': '.csv', 'hdf5': '.h5'}[kind] }"
    arguments = ["export", "demo", "--folder", str(run.folder), "--to", kind, "-o", str(output), "--json"]
    result = CliRunner().invoke(command, arguments)
    assert result.exit_code == 0, result.output
    document = json.loads(result.output)
    rows = {name: read_table(kind, output, name) for name in ("grid", "samples", "moves")}
    assert {name: len(each) for name, each in rows.items()} == document["rows"]
    for row in rows["samples"]:
        assert float(row["position"]) == run.published[row["axis"], int(row["fleet_ns"])]
    assert {row["verdict"] for row in rows["moves"]} == {"green"}
    units, verdicts = read_metadata(kind, output)
    assert units["gantry.x.position"] == "mm" and units["stage.focus.velocity"] == "um/s"
    report = run.reports[1]
    assert verdicts == {str(each.index): each.verdict for each in report.steps if each.verdict != "none"}


def read_table(kind: str, output: Path, name: str) -> list[dict[str, Any]]:
    if kind == "hdf5":
        with h5py.File(output) as file:
            columns: Any = {key: file[f"{name}/{key}"][:] for key in file[name]}  # pyright: ignore
        text = {
            key: [each.decode() if isinstance(each, bytes) else each for each in values]
            for key, values in columns.items()
        }
        return [dict(zip(text, row, strict=True)) for row in zip(*text.values(), strict=True)]
    path = output if name == "grid" else output.with_name(f"{output.stem}.{name}{output.suffix}")
    if kind == "parquet":
        return pq.read_table(path).to_pylist()
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def read_metadata(kind: str, output: Path) -> tuple[dict[str, str], dict[str, str]]:
    if kind == "parquet":
        schema = pq.read_schema(output)
        units = {each.name: each.metadata[b"unit"].decode() for each in schema if each.metadata}
        return units, json.loads(schema.metadata[b"verdicts"])
    if kind == "hdf5":
        with h5py.File(output) as file:
            grid: Any = file["grid"]
            return {key: grid[key].attrs["units"] for key in grid if "units" in grid[key].attrs}, json.loads(
                grid.attrs["verdicts"]
            )
    about = json.loads(output.with_suffix(".json").read_text())["grid"]
    return about["units"], json.loads(about["verdicts"])


# Data frames


@pytest.mark.parametrize("library", ["pandas", "polars", None])
def test_a_report_is_a_data_frame_with_the_uncertainty_as_columns(run: Run, library: str | None) -> None:
    frame = JobResult.of(run.reports[1], ()).to_dataframe(library)
    assert type(frame).__module__.partition(".")[0] == (library or "pandas")
    columns = {name: list(frame[name]) for name in ("axis", "step", "start_t_lo_ns", "start_t_hi_ns", "verdict")}
    assert len(columns["axis"]) == sum(len(m.axes) for step in run.reports[1].steps for m in step.members.values())
    assert all(low <= high for low, high in zip(columns["start_t_lo_ns"], columns["start_t_hi_ns"], strict=True))


def test_the_points_of_a_result_are_a_data_frame(run: Run) -> None:
    frame = JobResult.of(run.reports[-1], (), run.points).points_to_dataframe("polars")
    assert list(frame["point"]) == [1, 2, 3] and list(frame["gantry.x target"]) == [0, 2, 4]
    assert list(JobResult.of(run.reports[1], ()).points_to_dataframe()["point"]) == []


def test_a_missing_library_is_named_with_the_remedy(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    table = make_moves_table(run.reports[1])
    monkeypatch.setattr("orchestrator.monitor.export.dataframe.find_spec", lambda name: None)
    with pytest.raises(NoDataFrames, match="pandas or polars is not installed; install it: pip install pandas"):
        make_dataframe(table)
    with pytest.raises(NoDataFrames, match="'excel' is no library for data frames"):
        make_dataframe(table, "excel")


# Bad input


def test_a_grid_that_would_be_too_large_is_refused(run: Run) -> None:
    with pytest.raises(ExportTooLarge, match="choose a longer --period"):
        make_grid_table(run.load(1), 1)


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["nothing", "--to", "csv", "-o", "x.csv"], 2, "no recording of job 'nothing'"),
        (["demo", "--to", "csv", "-o", "x.txt"], 2, "x.txt does not end with .csv write it so: -o x.csv"),
        (["demo", "--to", "csv", "-o", "x.csv", "--period", "10"], 2, "'10' is not a duration"),
        (["demo", "--to", "csv", "-o", "x.csv", "--period", "0 s"], 2, "must be more than nothing"),
        (["demo", "--to", "csv", "-o", "no/such/folder/x.csv"], 2, "No such file or directory"),
        (["missing.mcap", "--to", "csv", "-o", "x.csv"], 2, "missing.mcap: No such file or directory"),
    ],
)
def test_what_cannot_be_exported_is_explained(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], code: int, text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(command, ["export", *arguments, "--folder", str(run.folder)])
    assert result.exit_code == code and "Traceback" not in result.output
    assert text in " ".join(result.output.split())
    assert not list(tmp_path.glob("x*"))


def test_an_extra_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("orchestrator.cli.base.extras.find_spec", lambda name: None if name == "pyarrow" else object())
    result = CliRunner().invoke(command, ["export", "x", "--to", "parquet", "-o", str(tmp_path / "x.parquet")])
    assert result.exit_code == 2
    assert "not installed: pyarrow" in result.output and "pip install 'tutti[export]'" in result.output


def test_a_recording_that_is_deleted_while_it_is_exported_is_read_to_its_end(run: Run, tmp_path: Path) -> None:
    (path,) = run.folder.glob(f"job-*-{run.reports[1].job_id[:8]}.mcap")
    copy = tmp_path / path.name
    copy.write_bytes(path.read_bytes())
    with Recording(copy) as recording:
        copy.unlink()
        assert load_run(recording).report == run.reports[1]
